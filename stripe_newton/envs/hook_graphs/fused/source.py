# SPDX-License-Identifier: Apache-2.0
"""Source code of a chain: typed values of one row, in C++ that rounds as torch's own kernels do.

Torch runs each operation as a kernel of its own, so a product is rounded before another kernel adds to it. A compiler
that sees both in one function would contract them to one multiplication and addition with one rounding. On CUDA the
arithmetic is therefore written with intrinsics that are never contracted. The functions of the device's mathematical
library are compiled as torch compiles them, with contraction.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
import torch

__all__ = ["C_TYPES", "Source", "Value"]

C_TYPES: dict[torch.dtype, str] = {
    torch.float32: "float",
    torch.float64: "double",
    torch.int64: "long long",
    torch.int32: "int",
    torch.int16: "short",
    torch.int8: "signed char",
    torch.uint8: "unsigned char",
    torch.bool: "bool",
}
"""Types that chains can hold."""

_INTRINSICS = {
    (torch.float32, "+"): "__fadd_rn",
    (torch.float32, "-"): "__fsub_rn",
    (torch.float32, "*"): "__fmul_rn",
    (torch.float32, "/"): "__fdiv_rn",
    (torch.float64, "+"): "__dadd_rn",
    (torch.float64, "-"): "__dsub_rn",
    (torch.float64, "*"): "__dmul_rn",
    (torch.float64, "/"): "__ddiv_rn",
}


@dataclass(frozen=True)
class Value:
    """A number of one row: a variable or a literal.

    Attributes:
        text: Its name, or the literal.
        dtype: Its type.
    """

    text: str
    dtype: torch.dtype

    def __str__(self) -> str:
        return self.text


class Source:
    """Statements that each define a variable. Equal expressions share one.

    Attributes:
        cuda: Whether the code is for a GPU.
        lines: The statements.
    """

    def __init__(self, cuda: bool):
        self.cuda = cuda
        self.lines: list[str] = []
        self._known: dict[tuple[torch.dtype, str], Value] = {}

    def let(self, dtype: torch.dtype, expression: str) -> Value:
        """A variable with the value of an expression."""
        value = self._known.get((dtype, expression))
        if value is None:
            value = self._known[dtype, expression] = Value(f"v{len(self._known)}", dtype)
            self.lines.append(f"const {C_TYPES[dtype]} {value} = {expression};")
        return value

    def literal(self, number: bool | int | float, dtype: torch.dtype) -> Value:
        """A number as torch passes it to a kernel of a type."""
        if dtype == torch.bool:
            return Value("true" if number else "false", dtype)
        if not dtype.is_floating_point:
            least = number == -(2**63)  # no literal: C++ reads a minus sign and a number that is too large
            return Value("(-9223372036854775807ll - 1)" if least else f"{int(number)}ll", dtype)
        if dtype == torch.float64:
            return Value(repr(float(number)) if math.isfinite(number) else self._bits("q", float(number)), dtype)
        with np.errstate(over="ignore"):  # to infinity, as torch does
            rounded = float(np.float32(number))
        return Value(f"{rounded!r}f" if math.isfinite(rounded) else self._bits("i", rounded), dtype)

    def _bits(self, code: str, number: float) -> str:
        """Expression for an infinity or NaN, by its bits."""
        (bits,) = struct.unpack(code, struct.pack("d" if code == "q" else "f", number))
        if self.cuda:
            return f"__longlong_as_double({bits}ll)" if code == "q" else f"__int_as_float({bits})"
        return f"__builtin_bit_cast({'double' if code == 'q' else 'float'}, {bits}{'ll' if code == 'q' else ''})"

    def cast(self, value: Value, dtype: torch.dtype) -> Value:
        """A value in another type."""
        if value.dtype == dtype:
            return value
        if dtype == torch.bool:
            return self.let(dtype, f"{value} != 0")
        if dtype == torch.uint8 and value.dtype.is_floating_point:
            value = self.cast(value, torch.int64)  # as torch does, so that negative numbers wrap on every device
        return self.let(dtype, f"static_cast<{C_TYPES[dtype]}>({value})")

    # -- arithmetic, between values of one type

    def _binary(self, sign: str, a: Value, b: Value) -> Value:
        name = _INTRINSICS.get((a.dtype, sign)) if self.cuda else None
        return self.let(a.dtype, f"{name}({a}, {b})" if name else f"{a} {sign} {b}")

    def add(self, a: Value, b: Value) -> Value:
        """Sum; of booleans, whether one is true."""
        return self._binary("||" if a.dtype == torch.bool else "+", a, b)

    def sub(self, a: Value, b: Value) -> Value:
        """Difference."""
        return self._binary("-", a, b)

    def mul(self, a: Value, b: Value) -> Value:
        """Product; of booleans, whether both are true."""
        return self._binary("&&" if a.dtype == torch.bool else "*", a, b)

    def div(self, a: Value, b: Value) -> Value:
        """Quotient of floats."""
        return self._binary("/", a, b)

    def fma(self, a: Value, b: Value, c: Value) -> Value:
        """``a * b + c``, rounded once."""
        return self.call("fma", a, b, c)

    def call(self, name: str, *values: Value) -> Value:
        """A function of the C library, for the type of its arguments."""
        dtype = values[0].dtype
        suffix = "f" if dtype == torch.float32 else ""
        return self.let(dtype, f"::{name}{suffix}({', '.join(map(str, values))})")

    def select(self, condition: str | Value, a: Value, b: Value) -> Value:
        """One of two values."""
        return self.let(a.dtype, f"{condition} ? {a} : {b}")

    def test(self, condition: str) -> Value:
        """A condition."""
        return self.let(torch.bool, condition)
