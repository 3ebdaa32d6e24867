# SPDX-License-Identifier: Apache-2.0
"""Elementwise operations: how torch's kernels compute each of them, by its name in ATen.

Where torch's CPU and CUDA kernels differ, the code is that of the device. Sources are the kernels of ATen in
``aten/src/ATen/native``: its binary, unary, pointwise and comparison operations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch

from .rows import Unsupported
from .source import Source, Value

__all__ = ["ELEMENTWISE", "Elementwise", "Number", "power"]

Number: TypeAlias = "bool | int | float"
Function: TypeAlias = Callable[..., Value]


@dataclass(frozen=True)
class Elementwise:
    """An operation on numbers.

    Attributes:
        inputs: Names of its arguments that are tensors or numbers.
        function: Writes the code: of the source and a value for each input.
        computes: Type in which it computes: ``"promoted"`` is the common type of the inputs, ``"float"`` the same but
            for whole numbers, which become floats, ``"bool"`` compares with zero first, ``"own"`` leaves each input in
            its type.
    """

    inputs: tuple[str, ...]
    function: Function
    computes: str = "promoted"


def _function(name: str) -> Function:
    return lambda s, x: s.call(name, x)


def _compare(sign: str) -> Function:
    return lambda s, a, b: s.test(f"{a} {sign} {b}")


def _bitwise(sign: str) -> Function:
    return lambda s, a, b: s.let(a.dtype, f"{a} {sign} {b}")


def _whole(function: Function) -> Function:
    """The function for floats; whole numbers stay as they are."""
    return lambda s, x: function(s, x) if x.dtype.is_floating_point else x


def _neg(s: Source, x: Value) -> Value:
    return s.let(x.dtype, f"-{x}")


def _abs(s: Source, x: Value) -> Value:
    if x.dtype.is_floating_point:
        return s.call("fabs", x)
    if x.dtype in (torch.bool, torch.uint8):
        return x
    return s.let(x.dtype, f"{x} < 0 ? -{x} : {x}")


def _sign(s: Source, x: Value) -> Value:
    if x.dtype == torch.bool:
        return x
    zero = s.literal(0, x.dtype)
    return s.cast(s.let(torch.int32, f"({zero} < {x}) - ({x} < {zero})"), x.dtype)


def _maximum(s: Source, a: Value, b: Value) -> Value:
    """The larger one; NaN if one is NaN."""
    if not a.dtype.is_floating_point:
        return s.select(f"{a} > {b}", a, b)
    larger = s.call("fmax", a, b) if s.cuda else s.select(f"{a} > {b}", a, b)
    return s.let(a.dtype, f"{a} != {a} ? {a} : ({b} != {b} ? {b} : {larger})")


def _minimum(s: Source, a: Value, b: Value) -> Value:
    """The smaller one; NaN if one is NaN."""
    if not a.dtype.is_floating_point:
        return s.select(f"{a} < {b}", a, b)
    smaller = s.call("fmin", a, b) if s.cuda else s.select(f"{a} < {b}", a, b)
    return s.let(a.dtype, f"{a} != {a} ? {a} : ({b} != {b} ? {b} : {smaller})")


def _rsqrt(s: Source, x: Value) -> Value:
    return s.call("rsqrt", x) if s.cuda else s.div(s.literal(1, x.dtype), s.call("sqrt", x))


def _reciprocal(s: Source, x: Value) -> Value:
    return s.div(s.literal(1, x.dtype), x)


def _sigmoid(s: Source, x: Value) -> Value:
    # In one expression: torch's compiler sees it as one, too.
    one, name = s.literal(1, x.dtype), "expf" if x.dtype == torch.float32 else "exp"
    return s.let(x.dtype, f"{one} / ({one} + ::{name}(-{x}))")


def _remainder(s: Source, a: Value, b: Value) -> Value:
    if not a.dtype.is_floating_point:
        rest = s.let(a.dtype, f"{a} % {b}")
        return s.select(f"({rest} != 0) && (({rest} < 0) != ({b} < 0))", s.add(rest, b), rest)
    rest = s.call("fmod", a, b)
    return s.select(f"({rest} != 0) && (({b} < 0) != ({rest} < 0))", s.add(rest, b), rest)


def _fmod(s: Source, a: Value, b: Value) -> Value:
    return s.call("fmod", a, b) if a.dtype.is_floating_point else s.let(a.dtype, f"{a} % {b}")


def _is_nan(s: Source, x: Value) -> Value:
    return s.test(f"{x} != {x}")


def _is_inf(s: Source, x: Value) -> Value:
    return s.test(f"{_abs(s, x)} == {s.literal(float('inf'), x.dtype)}")


def _logical(sign: str) -> Function:
    return lambda s, a, b: s.test(f"{a} {sign} {b}")


def _bitwise_not(s: Source, x: Value) -> Value:
    return s.let(x.dtype, f"{'!' if x.dtype == torch.bool else '~'}{x}")


def _where(s: Source, condition: Value, a: Value, b: Value) -> Value:
    return s.select(condition, a, b)


def _copysign(s: Source, a: Value, b: Value) -> Value:
    if s.cuda:
        return s.call("copysign", a, b)
    return s.let(a.dtype, f"__builtin_copysign{'f' if a.dtype == torch.float32 else ''}({a}, {b})")


def _square(s: Source, x: Value) -> Value:
    return s.mul(x, x)


def _frac(s: Source, x: Value) -> Value:
    return s.sub(x, s.call("trunc", x))


def _relu(s: Source, x: Value) -> Value:
    return _maximum(s, x, s.literal(0, x.dtype))


def power(s: Source, x: Value, exponent: Number) -> Value:
    """A value to the power of a number, with the special cases that torch has."""
    if not x.dtype.is_floating_point:
        if exponent not in (0, 1, 2, 3):
            raise Unsupported(f"raises whole numbers to the power of {exponent}")
        return _small_power(s, x, int(exponent))
    if exponent in (0, 1, 2, 3):
        return _small_power(s, x, int(exponent))
    if exponent == -1:
        return _reciprocal(s, x)
    if exponent == -2:
        return _reciprocal(s, s.mul(x, x))
    if exponent == 0.5:
        return s.call("sqrt", x)
    if exponent == -0.5:
        return _rsqrt(s, x)
    return s.call("pow", x, s.literal(exponent, x.dtype))


def _small_power(s: Source, x: Value, exponent: int) -> Value:
    if exponent == 0:
        return s.literal(1, x.dtype)
    value = x
    for _ in range(exponent - 1):
        value = s.mul(value, x)
    return value


def _one(function: Function, computes: str = "promoted") -> Elementwise:
    return Elementwise(("self",), function, computes)


def _two(function: Function, computes: str = "promoted") -> Elementwise:
    return Elementwise(("self", "other"), function, computes)


_FLOAT_FUNCTIONS = {
    "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan", "sinh": "sinh",
    "cosh": "cosh", "tanh": "tanh", "exp": "exp", "log": "log", "sqrt": "sqrt",
}  # fmt: skip

ELEMENTWISE: dict[str, Elementwise] = {
    **{name: _one(_function(function), "float") for name, function in _FLOAT_FUNCTIONS.items()},
    "rsqrt": _one(_rsqrt, "float"),
    "reciprocal": _one(_reciprocal, "float"),
    "sigmoid": _one(_sigmoid, "float"),
    "floor": _one(_whole(_function("floor"))),
    "ceil": _one(_whole(_function("ceil"))),
    "trunc": _one(_whole(_function("trunc"))),
    "round": _one(_whole(_function("rint"))),
    "frac": _one(_frac),
    "neg": _one(_neg),
    "abs": _one(_abs),
    "sign": _one(_sign),
    "sgn": _one(_sign),
    "square": _one(_square),
    "relu": _one(_relu),
    "isnan": _one(_is_nan),
    "isinf": _one(_is_inf),
    "logical_not": _one(lambda s, x: s.test(f"!{x}"), "bool"),
    "bitwise_not": _one(_bitwise_not),
    "mul": _two(Source.mul),
    "maximum": _two(_maximum),
    "minimum": _two(_minimum),
    "atan2": _two(lambda s, a, b: s.call("atan2", a, b), "float"),
    "copysign": _two(_copysign, "float"),
    "remainder": _two(_remainder),
    "fmod": _two(_fmod),
    "eq": _two(_compare("==")),
    "ne": _two(_compare("!=")),
    "lt": _two(_compare("<")),
    "le": _two(_compare("<=")),
    "gt": _two(_compare(">")),
    "ge": _two(_compare(">=")),
    "logical_and": _two(_logical("&&"), "bool"),
    "logical_or": _two(_logical("||"), "bool"),
    "logical_xor": _two(_logical("!="), "bool"),
    "bitwise_and": _two(_bitwise("&")),
    "bitwise_or": _two(_bitwise("|")),
    "bitwise_xor": _two(_bitwise("^")),
    "where": Elementwise(("condition", "self", "other"), _where, "chosen"),
    "masked_fill": Elementwise(("mask", "value", "self"), _where, "filled"),
}
"""Operations whose result depends on nothing but the values of their inputs. Those with other arguments, such as
``add`` with ``alpha``, are in :mod:`.operations`."""
