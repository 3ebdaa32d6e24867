# SPDX-License-Identifier: Apache-2.0
"""Operations of chains: for each ATen operation, which elements of a row it reads, and the code of its result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from .call import Call
from .elementwise import ELEMENTWISE, Number, power
from .indexing import INDEXING
from .memory import Access
from .plan import Operand, Plan
from .rounding import OfSource, cross, cross_variants, divides_by_reciprocal, find_reduction, fuses_alpha
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["OPERATIONS", "plan"]


def plan(call: Call, rows: int) -> Plan:
    """The plan of a call.

    Raises:
        Unsupported: if it cannot be part of a chain.
    """
    make = OPERATIONS.get(call.name) or INDEXING.get(call.name)
    if make is not None:
        return make(call, rows)
    if call.name in ELEMENTWISE:
        return _elementwise(call, rows)
    raise Unsupported("is not known")


# -- elementwise


@dataclass
class _Result:
    """Where the result of a call goes."""

    like: torch.Tensor | None
    target: torch.Tensor | None
    shape: tuple[int, ...] = field(init=False)
    dtype: torch.dtype = field(init=False)

    def __post_init__(self) -> None:
        tensor = self.target if self.target is not None else self.like
        assert tensor is not None
        self.shape, self.dtype = tuple(tensor.shape), tensor.dtype


def _result(call: Call) -> _Result:
    return _Result(call.like() if call.target is None else None, call.target)


def _common(operands: Sequence[Operand]) -> torch.dtype:
    """Type that torch computes in, for some tensors and numbers."""
    tensors = [o for o in operands if isinstance(o, torch.Tensor)]
    if len(operands) == 1:
        return tensors[0].dtype
    if len(operands) == 2:
        return torch.result_type(operands[0], operands[1])  # type: ignore[call-overload, no-any-return]
    if any(t.dtype != tensors[0].dtype for t in tensors):
        raise Unsupported("mixes types")
    return tensors[0].dtype


def _float_type(dtype: torch.dtype) -> torch.dtype:
    return dtype if dtype.is_floating_point else torch.get_default_dtype()


def _map(
    call: Call,
    rows: int,
    operands: Sequence[Operand],
    function: Callable[..., Value],
    types: Sequence[torch.dtype | None],
) -> Plan:
    """The plan of a function of numbers.

    Args:
        call: The call.
        rows: Number of rows.
        operands: Tensors and numbers that are the function's arguments.
        function: Writes the code of one element.
        types: Type that each operand is converted to; None leaves a tensor in its own.
    """
    result = _result(call)
    frame = Frame.of(result.shape, rows)
    inputs = [Access(o, frame.view(o)) for o in operands if isinstance(o, torch.Tensor)]

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        columns = iter(read)
        arguments: list[list[Value]] = []
        for operand, dtype in zip(operands, types, strict=True):
            if isinstance(operand, torch.Tensor):
                arguments.append([s.cast(v, dtype) if dtype is not None else v for v in next(columns)])
            else:
                assert dtype is not None
                arguments.append([s.literal(operand, dtype)] * math.prod(frame.inner))
        return [function(s, *values) for values in zip(*arguments, strict=True)]

    return Plan(frame, inputs, compute, result.like, result.target)


def _elementwise(call: Call, rows: int) -> Plan:
    operation = ELEMENTWISE[call.name]
    operands = [call.operand(name) for name in operation.inputs]
    types: list[torch.dtype | None]
    if operation.computes == "chosen":
        common = _common(operands[1:])
        types = [torch.bool, common, common]
    elif operation.computes == "filled":
        own = call.tensor("self").dtype
        types = [torch.bool, own, own]
    elif operation.computes == "bool":
        types = [torch.bool] * len(operands)
    else:
        common = _common(operands)
        types = [_float_type(common) if operation.computes == "float" else common] * len(operands)
    return _map(call, rows, operands, operation.function, types)


def _add(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("self"), call.operand("other"), 1)


def _sub(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("self"), call.operand("other"), -1)


def _rsub(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("other"), call.operand("self"), -1)


def _sum_of(call: Call, rows: int, a: Operand, b: Operand, sign: int) -> Plan:
    """``a + sign * alpha * b``."""
    alpha, common = call.number("alpha"), _common([a, b])

    def function(s: Source, x: Value, y: Value) -> Value:
        if alpha == 1:
            return s.add(x, y) if sign == 1 else s.sub(x, y)
        factor = s.literal(sign * alpha, x.dtype)
        if x.dtype.is_floating_point and fuses_alpha(call.device, x.dtype):
            return s.fma(factor, y, x)
        return s.add(x, s.mul(factor, y))

    return _map(call, rows, [a, b], function, [common, common])


def _div(call: Call, rows: int) -> Plan:
    a, b = call.operand("self"), call.operand("other")
    if call.named.get("rounding_mode") is not None:
        raise Unsupported("rounds a quotient")
    common = _float_type(_common([a, b]))
    if isinstance(b, torch.Tensor) or not divides_by_reciprocal(call.device, common):
        return _map(call, rows, [a, b], lambda s, x, y: s.div(x, y), [common, common])
    inverse = (1.0 / torch.tensor(b, dtype=common)).item()
    return _map(call, rows, [a, inverse], lambda s, x, y: s.mul(x, y), [common, common])


def _pow(call: Call, rows: int) -> Plan:
    base, exponent = call.tensor("self"), call.number("exponent")
    common = torch.result_type(base, exponent)
    return _map(call, rows, [base], lambda s, x: power(s, x, exponent), [common])


def _clamp(call: Call, rows: int) -> Plan:
    low, high = (call.named.get(name) for name in ("min", "max"))
    bounds = [b for b in (low, high) if b is not None]
    if not all(isinstance(b, (torch.Tensor, bool, int, float)) for b in bounds):
        raise Unsupported("has bounds of another kind")
    operands: list[Operand] = [call.tensor("self"), *bounds]  # type: ignore[list-item]
    common = _common(operands[:2])
    if len(operands) == 3 and torch.result_type(operands[0], operands[2]) != common:
        raise Unsupported("mixes types")
    larger, smaller = ELEMENTWISE["maximum"].function, ELEMENTWISE["minimum"].function

    def function(s: Source, x: Value, *limits: Value) -> Value:
        given = iter(limits)
        x = larger(s, x, next(given)) if low is not None else x
        return smaller(s, x, next(given)) if high is not None else x

    return _map(call, rows, operands, function, [common] * len(operands))


def _lerp(call: Call, rows: int) -> Plan:
    operands = [call.operand(name) for name in ("self", "end", "weight")]
    common = _common([operands[0], operands[1]])

    def function(s: Source, a: Value, b: Value, w: Value) -> Value:
        # One expression, as in torch's kernel: compilers contract it in the same way.
        near, far = f"{a} + {w} * ({b} - {a})", f"{b} - ({b} - {a}) * (1 - {w})"
        return s.let(a.dtype, f"({w} < 0 ? -{w} : {w}) < {s.literal(0.5, w.dtype)} ? {near} : {far}")

    return _map(call, rows, operands, function, [common] * 3)


def _addcmul(call: Call, rows: int) -> Plan:
    return _pointwise(call, rows, "*")


def _addcdiv(call: Call, rows: int) -> Plan:
    return _pointwise(call, rows, "/")


def _pointwise(call: Call, rows: int, sign: str) -> Plan:
    operands = [call.tensor(name) for name in ("self", "tensor1", "tensor2")]
    value, common = call.number("value"), _common(operands)

    def function(s: Source, a: Value, b: Value, c: Value) -> Value:
        return s.let(a.dtype, f"{a} + {s.literal(value, a.dtype)} * {b} {sign} {c}")

    return _map(call, rows, operands, function, [common] * 3)


def _nan_to_num(call: Call, rows: int) -> Plan:
    x = call.tensor("self")
    if not x.dtype.is_floating_point:
        return _map(call, rows, [x], lambda s, v: v, [x.dtype])
    limits = torch.finfo(x.dtype)
    given = [call.named.get(name) for name in ("nan", "posinf", "neginf")]
    nan, high, low = (d if g is None else g for g, d in zip(given, (0.0, limits.max, limits.min), strict=True))

    def function(s: Source, v: Value) -> Value:
        inf = s.literal(math.inf, v.dtype)
        numbers = [s.literal(n, v.dtype) for n in (nan, high, low)]  # type: ignore[arg-type]
        finite = f"({v} == {inf} ? {numbers[1]} : ({v} == -{inf} ? {numbers[2]} : {v}))"
        return s.let(v.dtype, f"{v} != {v} ? {numbers[0]} : {finite}")

    return _map(call, rows, [x], function, [x.dtype])


# -- copies


def _copy(call: Call, rows: int) -> Plan:
    return _set(call, rows, call.operand("src"))


def _clone(call: Call, rows: int) -> Plan:
    return _map(call, rows, [call.tensor("self")], lambda s, x: x, [None])


def _to_copy(call: Call, rows: int) -> Plan:
    if call.named.get("device") not in (None, call.device):
        raise Unsupported("copies to another device")
    return _clone(call, rows)


def _fill(call: Call, rows: int) -> Plan:
    return _set(call, rows, call.operand("value"))


def _set(call: Call, rows: int, value: Operand) -> Plan:
    """The plan of setting elements to a tensor or a number."""
    return _map(call, rows, [value], lambda s, x: x, [None if isinstance(value, torch.Tensor) else _result(call).dtype])


def _filled(name: str | float) -> Callable[[Call, int], Plan]:
    """An operation that makes or fills a tensor with one number: an argument of that name, or the number."""

    def make(call: Call, rows: int) -> Plan:
        if call.target is None and call.named.get("device") not in (None, call.device):
            raise Unsupported("is on another device")
        number: Number = call.number(name) if isinstance(name, str) else name
        return _map(call, rows, [number], lambda s, x: x, [_result(call).dtype])

    return make


def _rearranged(call: Call, rows: int, tensors: Sequence[torch.Tensor], order: Callable[..., np.ndarray]) -> Plan:
    """The plan of an operation that puts elements elsewhere.

    Args:
        call: The call.
        rows: Number of rows.
        tensors: The tensors.
        order: Makes, of the numbers of the elements of each tensor's rows in their shapes, those of the result.
    """
    result = _result(call)
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


# -- within a row


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
    x, result = call.tensor("self"), _result(call)
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
        dtype = _result(call).dtype
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
    x, y, result = call.tensor("self"), call.tensor("other"), _result(call)
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


OPERATIONS: dict[str, Callable[[Call, int], Plan]] = {
    "add": _add, "sub": _sub, "rsub": _rsub, "div": _div, "true_divide": _div, "pow": _pow, "clamp": _clamp,
    "clamp_min": _clamp, "clamp_max": _clamp, "lerp": _lerp, "addcmul": _addcmul, "addcdiv": _addcdiv,
    "nan_to_num": _nan_to_num, "copy": _copy, "clone": _clone, "_to_copy": _to_copy, "fill": _fill,
    "zero": _filled(0), "zeros": _filled(0), "zeros_like": _filled(0), "new_zeros": _filled(0), "ones": _filled(1),
    "ones_like": _filled(1), "new_ones": _filled(1), "full": _filled("fill_value"), "full_like": _filled("fill_value"),
    "new_full": _filled("fill_value"), "scalar_tensor": _filled("s"), "cat": _cat, "stack": _stack, "repeat": _repeat,
    "flip": _flip, "roll": _roll, "sum": _rounded_reduction("sum"), "mean": _rounded_reduction("mean"),
    "prod": _rounded_reduction("prod"), "linalg_vector_norm": _norm, "amax": _extreme("maximum"),
    "amin": _extreme("minimum"), "any": _any, "all": _all, "count_nonzero": _count_nonzero, "linalg_cross": _cross,
}  # fmt: skip
"""Makers of plans, by the name of the operation in ATen without the underscore of its form in place."""
