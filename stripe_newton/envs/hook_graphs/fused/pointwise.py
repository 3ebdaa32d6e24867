# SPDX-License-Identifier: Apache-2.0
"""Pointwise operations of chains: a function of the elements at one place of several tensors, which broadcast."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch

from .call import Call
from .elementwise import ELEMENTWISE, power
from .memory import Access
from .plan import Operand, Plan
from .rounding import divides_by_reciprocal, fuses_alpha
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["POINTWISE", "Result", "elementwise", "pointwise", "result_of"]


@dataclass
class Result:
    """Where the result of a call goes."""

    like: torch.Tensor | None
    target: torch.Tensor | None
    shape: tuple[int, ...] = field(init=False)
    dtype: torch.dtype = field(init=False)

    def __post_init__(self) -> None:
        tensor = self.target if self.target is not None else self.like
        assert tensor is not None
        self.shape, self.dtype = tuple(tensor.shape), tensor.dtype


def result_of(call: Call) -> Result:
    """Where the result of a call goes: to the tensor that it writes, or to one that it makes."""
    return Result(call.like() if call.target is None else None, call.target)


def _common_type(operands: Sequence[Operand]) -> torch.dtype:
    """Type that torch computes in, for some tensors and numbers."""
    tensors = [o for o in operands if isinstance(o, torch.Tensor)]
    if len(operands) == 1:
        return tensors[0].dtype
    if len(operands) == 2:
        return torch.result_type(operands[0], operands[1])
    if any(t.dtype != tensors[0].dtype for t in tensors):
        raise Unsupported("mixes types")
    return tensors[0].dtype


def _float_type(dtype: torch.dtype) -> torch.dtype:
    return dtype if dtype.is_floating_point else torch.get_default_dtype()


def pointwise(
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
    result = result_of(call)
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


def elementwise(call: Call, rows: int) -> Plan:
    """The plan of an operation of :data:`.elementwise.ELEMENTWISE`."""
    operation = ELEMENTWISE[call.name]
    operands = [call.operand(name) for name in operation.inputs]
    types: list[torch.dtype | None]
    if operation.computes == "chosen":
        common = _common_type(operands[1:])
        types = [torch.bool, common, common]
    elif operation.computes == "filled":
        own = call.tensor("self").dtype
        types = [torch.bool, own, own]
    elif operation.computes == "bool":
        types = [torch.bool] * len(operands)
    else:
        common = _common_type(operands)
        types = [_float_type(common) if operation.computes == "float" else common] * len(operands)
    return pointwise(call, rows, operands, operation.function, types)


def _add(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("self"), call.operand("other"), 1)


def _sub(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("self"), call.operand("other"), -1)


def _rsub(call: Call, rows: int) -> Plan:
    return _sum_of(call, rows, call.operand("other"), call.operand("self"), -1)


def _sum_of(call: Call, rows: int, a: Operand, b: Operand, sign: int) -> Plan:
    """``a + sign * alpha * b``."""
    alpha, common = call.number("alpha"), _common_type([a, b])

    def function(s: Source, x: Value, y: Value) -> Value:
        if alpha == 1:
            return s.add(x, y) if sign == 1 else s.sub(x, y)
        factor = s.literal(sign * alpha, x.dtype)
        if x.dtype.is_floating_point and fuses_alpha(call.device, x.dtype):
            return s.fma(factor, y, x)
        return s.add(x, s.mul(factor, y))

    return pointwise(call, rows, [a, b], function, [common, common])


def _div(call: Call, rows: int) -> Plan:
    a, b = call.operand("self"), call.operand("other")
    if call.named.get("rounding_mode") is not None:
        raise Unsupported("rounds a quotient")
    common = _float_type(_common_type([a, b]))
    if isinstance(b, torch.Tensor) or not divides_by_reciprocal(call.device, common):
        return pointwise(call, rows, [a, b], lambda s, x, y: s.div(x, y), [common, common])
    inverse = (1.0 / torch.tensor(b, dtype=common)).item()
    return pointwise(call, rows, [a, inverse], lambda s, x, y: s.mul(x, y), [common, common])


def _pow(call: Call, rows: int) -> Plan:
    base, exponent = call.tensor("self"), call.number("exponent")
    common = torch.result_type(base, exponent)
    return pointwise(call, rows, [base], lambda s, x: power(s, x, exponent), [common])


def _clamp(call: Call, rows: int) -> Plan:
    low, high = (call.named.get(name) for name in ("min", "max"))
    bounds = [b for b in (low, high) if b is not None]
    if not all(isinstance(b, (torch.Tensor, bool, int, float)) for b in bounds):
        raise Unsupported("has bounds of another kind")
    operands: list[Operand] = [call.tensor("self"), *bounds]  # type: ignore[list-item]
    common = _common_type(operands[:2])
    if len(operands) == 3 and torch.result_type(operands[0], operands[2]) != common:
        raise Unsupported("mixes types")
    larger, smaller = ELEMENTWISE["maximum"].function, ELEMENTWISE["minimum"].function

    def function(s: Source, x: Value, *limits: Value) -> Value:
        given = iter(limits)
        x = larger(s, x, next(given)) if low is not None else x
        return smaller(s, x, next(given)) if high is not None else x

    return pointwise(call, rows, operands, function, [common] * len(operands))


def _lerp(call: Call, rows: int) -> Plan:
    operands = [call.operand(name) for name in ("self", "end", "weight")]
    common = _common_type([operands[0], operands[1]])

    def function(s: Source, a: Value, b: Value, w: Value) -> Value:
        # One expression, as in torch's kernel: compilers contract it in the same way.
        near, far = f"{a} + {w} * ({b} - {a})", f"{b} - ({b} - {a}) * (1 - {w})"
        return s.let(a.dtype, f"({w} < 0 ? -{w} : {w}) < {s.literal(0.5, w.dtype)} ? {near} : {far}")

    return pointwise(call, rows, operands, function, [common] * 3)


def _addcmul(call: Call, rows: int) -> Plan:
    return _pointwise(call, rows, "*")


def _addcdiv(call: Call, rows: int) -> Plan:
    return _pointwise(call, rows, "/")


def _pointwise(call: Call, rows: int, sign: str) -> Plan:
    operands = [call.tensor(name) for name in ("self", "tensor1", "tensor2")]
    value, common = call.number("value"), _common_type(operands)

    def function(s: Source, a: Value, b: Value, c: Value) -> Value:
        factor = s.literal(value, a.dtype)
        # In one expression, which compilers contract as they contract torch's; the order is that of the device.
        return s.let(a.dtype, f"{a} + {factor} * ({b} {sign} {c})" if s.cuda else f"{a} + {factor} * {b} {sign} {c}")

    return pointwise(call, rows, operands, function, [common] * 3)


def _nan_to_num(call: Call, rows: int) -> Plan:
    x = call.tensor("self")
    if not x.dtype.is_floating_point:
        return pointwise(call, rows, [x], lambda s, v: v, [x.dtype])
    limits = torch.finfo(x.dtype)
    given = [call.named.get(name) for name in ("nan", "posinf", "neginf")]
    nan, high, low = (d if g is None else g for g, d in zip(given, (0.0, limits.max, limits.min), strict=True))

    def function(s: Source, v: Value) -> Value:
        inf = s.literal(math.inf, v.dtype)
        numbers = [s.literal(n, v.dtype) for n in (nan, high, low)]  # type: ignore[arg-type]
        finite = f"({v} == {inf} ? {numbers[1]} : ({v} == -{inf} ? {numbers[2]} : {v}))"
        return s.let(v.dtype, f"{v} != {v} ? {numbers[0]} : {finite}")

    return pointwise(call, rows, [x], function, [x.dtype])


POINTWISE: dict[str, Callable[[Call, int], Plan]] = {
    "add": _add,
    "sub": _sub,
    "rsub": _rsub,
    "div": _div,
    "true_divide": _div,
    "pow": _pow,
    "clamp": _clamp,
    "clamp_min": _clamp,
    "clamp_max": _clamp,
    "lerp": _lerp,
    "addcmul": _addcmul,
    "addcdiv": _addcdiv,
    "nan_to_num": _nan_to_num,
}
"""Makers of plans of operations with arguments other than tensors and numbers to compute with."""
