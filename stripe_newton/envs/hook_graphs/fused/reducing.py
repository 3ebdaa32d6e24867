# SPDX-License-Identifier: Apache-2.0
"""Reducing operations of chains: sums, means, norms and the like within a row, and cross products."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from .call import Call
from .elementwise import ELEMENTWISE
from .memory import Access
from .plan import Plan
from .pointwise import result_of
from .rounding import OfSource, cross, cross_variants, find_reduction
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["REDUCING"]


def _reduced_dims(call: Call, x: torch.Tensor) -> tuple[int, ...]:
    dims = call.named.get("dim")
    if dims is None or dims == []:
        return tuple(range(x.dim()))
    given: Sequence[int] = [dims] if isinstance(dims, int) else dims  # type: ignore[assignment]
    return tuple(sorted({dim % max(x.dim(), 1) for dim in given}))


def _reduction(call: Call, rows: int, dtype: torch.dtype | None, fold: Callable[..., Value]) -> Plan:
    """The plan of a reduction.

    Args:
        call: The call.
        rows: Number of rows.
        dtype: Type that elements are converted to; None leaves them in their own.
        fold: Writes the code of the result of some elements.
    """
    x, result = call.tensor("self"), result_of(call)
    dims = _reduced_dims(call, x)
    frame = Frame.of(x.shape, rows, without=dims)
    kept = tuple(1 if d in dims else size for d, size in enumerate(frame.shape))
    reduced = Frame(kept, frame.row_dim, frame.split)
    order = np.moveaxis(np.arange(math.prod(frame.inner)).reshape(frame.inner), dims, range(-len(dims), 0))
    groups = order.reshape(math.prod(reduced.inner), -1).tolist()

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        elements = [s.cast(v, dtype) if dtype is not None else v for v in read[0]]
        return [fold(s, [elements[place] for place in group]) for group in groups]

    expanded = () if len(result.shape) == x.dim() else dims
    return Plan(reduced, [Access(x, frame.view(x))], compute, result.like, result.target, expanded)


def _rounded_reduction(kind: str) -> Callable[[Call, int], Plan]:
    def make(call: Call, rows: int) -> Plan:
        x = call.tensor("self")
        dtype = result_of(call).dtype
        if kind in ("sum", "prod") and not dtype.is_floating_point:
            function = Source.add if kind == "sum" else Source.mul
            return _reduction(call, rows, dtype, _in_series(function))
        dims = [d for d in _reduced_dims(call, x) if x.shape[d] > 1]
        if not x.dtype.is_floating_point or x.dtype != dtype or len(dims) > 1:
            raise Unsupported("adds in an order that is not known")
        if not dims and kind in ("sum", "mean", "prod"):
            return _reduction(call, rows, None, lambda s, elements: elements[0])
        Frame.of(x.shape, rows, without=_reduced_dims(call, x))
        found = find_reduction(kind, x, dims[0] if dims else _reduced_dims(call, x)[0])
        if found is None:
            raise Unsupported("adds in an order that is not known")
        return _reduction(call, rows, None, found.of_values)

    return make


def _in_series(function: Callable[[Source, Value, Value], Value]) -> Callable[[Source, list[Value]], Value]:
    def fold(s: Source, elements: list[Value]) -> Value:
        total = elements[0]
        for element in elements[1:]:
            total = function(s, total, element)
        return total

    return fold


def _norm(call: Call, rows: int) -> Plan:
    if call.number("ord") != 2 or call.named.get("dtype") is not None:
        raise Unsupported("is another norm")
    return _rounded_reduction("norm")(call, rows)


def _extreme(name: str) -> Callable[[Call, int], Plan]:
    function = ELEMENTWISE[name].function
    return lambda call, rows: _reduction(call, rows, None, _in_series(function))


def _any(call: Call, rows: int) -> Plan:
    return _reduction(call, rows, torch.bool, _in_series(Source.add))


def _all(call: Call, rows: int) -> Plan:
    return _reduction(call, rows, torch.bool, _in_series(Source.mul))


def _count_nonzero(call: Call, rows: int) -> Plan:
    def fold(s: Source, elements: list[Value]) -> Value:
        counted = [s.cast(s.cast(element, torch.bool), torch.int64) for element in elements]
        return _in_series(Source.add)(s, counted)

    return _reduction(call, rows, None, fold)


def _cross(call: Call, rows: int) -> Plan:
    x, y, result = call.tensor("self"), call.tensor("other"), result_of(call)
    dim = int(call.number("dim")) % len(result.shape)
    frame = Frame.of(result.shape, rows, without=(dim,))
    variants = cross_variants(call.device, x.dtype) if x.dtype.is_floating_point else ("plain",) * 3
    if variants is None or x.dtype != y.dtype:
        raise Unsupported("contracts in a way that is not known")
    places = np.arange(math.prod(frame.inner)).reshape(frame.inner)
    vectors = np.moveaxis(places, dim, -1).reshape(-1, 3).tolist()

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        a, b = read
        found = list(a)
        for vector in vectors:
            for i in range(3):
                j, k = vector[(i + 1) % 3], vector[(i + 2) % 3]
                found[vector[i]] = cross(OfSource(s), variants[i], a[j], b[k], a[k], b[j])
        return found

    return Plan(frame, [Access(x, frame.view(x)), Access(y, frame.view(y))], compute, result.like, result.target)


REDUCING: dict[str, Callable[[Call, int], Plan]] = {
    "sum": _rounded_reduction("sum"),
    "mean": _rounded_reduction("mean"),
    "prod": _rounded_reduction("prod"),
    "linalg_vector_norm": _norm,
    "amax": _extreme("maximum"),
    "amin": _extreme("minimum"),
    "any": _any,
    "all": _all,
    "count_nonzero": _count_nonzero,
    "linalg_cross": _cross,
}
"""Makers of plans of operations that combine elements of a row."""
