# SPDX-License-Identifier: Apache-2.0
"""Moving operations of chains: copies, fills, and results whose elements are those of tensors at other places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from .call import Call
from .elementwise import Number
from .memory import Access
from .plan import Operand, Plan
from .pointwise import pointwise, result_of
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["MOVING"]


def _copy(call: Call, rows: int) -> Plan:
    return _set(call, rows, call.operand("src"))


def _clone(call: Call, rows: int) -> Plan:
    return pointwise(call, rows, [call.tensor("self")], lambda s, x: x, [None])


def _to_copy(call: Call, rows: int) -> Plan:
    if call.named.get("device") not in (None, call.device):
        raise Unsupported("copies to another device")
    return _clone(call, rows)


def _fill(call: Call, rows: int) -> Plan:
    return _set(call, rows, call.operand("value"))


def _set(call: Call, rows: int, value: Operand) -> Plan:
    """The plan of setting elements to a tensor or a number."""
    return pointwise(
        call, rows, [value], lambda s, x: x, [None if isinstance(value, torch.Tensor) else result_of(call).dtype]
    )


def _filled(name: str | float) -> Callable[[Call, int], Plan]:
    """An operation that makes or fills a tensor with one number: an argument of that name, or the number."""

    def make(call: Call, rows: int) -> Plan:
        if call.target is None and call.named.get("device") not in (None, call.device):
            raise Unsupported("is on another device")
        number: Number = call.number(name) if isinstance(name, str) else name
        return pointwise(call, rows, [number], lambda s, x: x, [result_of(call).dtype])

    return make


def _rearranged(call: Call, rows: int, tensors: Sequence[torch.Tensor], order: Callable[..., np.ndarray]) -> Plan:
    """The plan of an operation that puts elements elsewhere.

    Args:
        call: The call.
        rows: Number of rows.
        tensors: The tensors.
        order: Makes, of the numbers of the elements of each tensor's rows in their shapes, those of the result.
    """
    result = result_of(call)
    frame = Frame.of(result.shape, rows)
    frames = [_frame_along(t.shape, frame, rows) for t in tensors]
    inputs = [Access(t, f.view(t)) for t, f in zip(tensors, frames, strict=True)]
    counts = [math.prod(f.inner) for f in frames]
    starts = np.cumsum([0, *counts])
    numbers = [
        np.arange(start, start + count).reshape(f.inner)
        for start, count, f in zip(starts, counts, frames, strict=False)
    ]
    places = order(*numbers).reshape(-1).tolist()
    if len(places) != math.prod(frame.inner):
        raise Unsupported("mixes rows")

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        elements = [value for values in read for value in values]
        return [elements[place] for place in places]

    return Plan(frame, inputs, compute, result.like, result.target)


def _frame_along(shape: Sequence[int], frame: Frame, rows: int) -> Frame:
    """The frame of an operand whose rows are counted by the same dimension as those of the result."""
    if frame.row_dim is None:
        return Frame(tuple(shape), None)
    dim = frame.row_dim
    if dim >= len(shape) or shape[dim] != rows * frame.split:
        raise Unsupported("mixes rows")
    return Frame(tuple(shape), dim, frame.split)


def _cat(call: Call, rows: int) -> Plan:
    tensors = [t for t in call.named["tensors"] if t.shape != (0,)]  # type: ignore[attr-defined]
    if not tensors or any(t.dim() != tensors[0].dim() for t in tensors):
        raise Unsupported("joins nothing")
    dim = int(call.number("dim")) % tensors[0].dim()
    return _typed(call, _rearranged(call, rows, tensors, lambda *parts: np.concatenate(parts, axis=dim)))


def _stack(call: Call, rows: int) -> Plan:
    tensors = list(call.named["tensors"])  # type: ignore[call-overload]
    dim = int(call.number("dim")) % (tensors[0].dim() + 1)
    views = [t.unsqueeze(dim) for t in tensors]
    return _typed(call, _rearranged(call, rows, views, lambda *parts: np.concatenate(parts, axis=dim)))


def _typed(call: Call, found: Plan) -> Plan:
    """A plan whose inputs are converted to the type of the result, by way of their common type."""
    inner = found.compute
    tensors = [access.tensor for access in found.inputs]
    if any(t.dtype != tensors[0].dtype for t in tensors):
        common = (found.like if found.like is not None else found.target).dtype  # type: ignore[union-attr]
        found.compute = lambda s, read: inner(s, [[s.cast(v, common) for v in values] for values in read])
    return found


def _repeat(call: Call, rows: int) -> Plan:
    x, repeats = call.tensor("self"), call.sizes("repeats")
    for _ in range(len(repeats) - x.dim()):
        x = x.unsqueeze(0)
    return _rearranged(call, rows, [x], lambda part: np.tile(part, repeats))


def _flip(call: Call, rows: int) -> Plan:
    x, dims = call.tensor("self"), call.sizes("dims")
    _stays(Frame.of(x.shape, rows), dims, x.dim())
    return _rearranged(call, rows, [x], lambda part: np.flip(part, dims))


def _roll(call: Call, rows: int) -> Plan:
    x = call.tensor("self")
    shifts, dims = call.sizes("shifts"), call.sizes("dims")
    if not dims:
        raise Unsupported("mixes rows")
    _stays(Frame.of(x.shape, rows), dims, x.dim())
    return _rearranged(call, rows, [x], lambda part: np.roll(part, shifts, dims))


def _stays(frame: Frame, dims: Sequence[int], total: int) -> None:
    if frame.row_dim in [dim % total for dim in dims]:
        raise Unsupported("mixes rows")


MOVING: dict[str, Callable[[Call, int], Plan]] = {
    "copy": _copy,
    "clone": _clone,
    "_to_copy": _to_copy,
    "fill": _fill,
    "zero": _filled(0),
    "zeros": _filled(0),
    "zeros_like": _filled(0),
    "new_zeros": _filled(0),
    "ones": _filled(1),
    "ones_like": _filled(1),
    "new_ones": _filled(1),
    "full": _filled("fill_value"),
    "full_like": _filled("fill_value"),
    "new_full": _filled("fill_value"),
    "scalar_tensor": _filled("s"),
    "cat": _cat,
    "stack": _stack,
    "repeat": _repeat,
    "flip": _flip,
    "roll": _roll,
}
"""Makers of plans of operations that compute nothing."""
