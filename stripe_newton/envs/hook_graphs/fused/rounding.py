# SPDX-License-Identifier: Apache-2.0
"""Rounding rules of torch's kernels, found by trial: the order of a reduction, and products fused with sums.

Torch sums the elements of a row in an order that depends on its version, the device and the shape. Each order that
torch is known to use is written once, for numbers of any kind: with tensors it is compared with what torch gives for
random numbers, bit for bit, and the one that agrees writes the code of a chain. Where none agrees, torch itself sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import torch

from .source import Source, Value

__all__ = ["Reduction", "cross", "cross_variants", "divides_by_reciprocal", "find_reduction", "fuses_alpha"]

T = TypeVar("T")


class Arithmetic(Protocol[T]):
    """Operations that are each rounded once, but for those that are exact."""

    def add(self, a: T, b: T) -> T: ...
    def sub(self, a: T, b: T) -> T: ...
    def mul(self, a: T, b: T) -> T: ...
    def div(self, a: T, b: T) -> T: ...
    def fma(self, a: T, b: T, c: T) -> T: ...
    def neg(self, a: T) -> T: ...
    def sqrt(self, a: T) -> T: ...
    def number(self, number: float, like: T) -> T: ...


class OfTensors:
    """Arithmetic of tensors, each operation by a kernel of torch's."""

    def add(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return a + b

    def sub(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return a - b

    def mul(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return a * b

    def div(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return a / b

    def fma(self, a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
        # The product of two float32 is exact in float64. The sum is rounded twice, to float64 and to float32, which
        # gives another number than one rounding about once in 2**29 times: such a number would only hide a variant.
        return (a.double() * b.double() + c.double()).to(a.dtype)

    def neg(self, a: torch.Tensor) -> torch.Tensor:
        return -a

    def sqrt(self, a: torch.Tensor) -> torch.Tensor:
        return a.double().sqrt().to(a.dtype)  # exact, which torch's on a CPU is not for float32

    def number(self, number: float, like: torch.Tensor) -> torch.Tensor:
        return torch.full_like(like, number)


class OfSource:
    """Arithmetic of source code."""

    def __init__(self, source: Source):
        self.add, self.sub, self.mul, self.div = source.add, source.sub, source.mul, source.div
        self.fma = source.fma
        self._source = source

    def neg(self, a: Value) -> Value:
        return self._source.let(a.dtype, f"-{a}")

    def sqrt(self, a: Value) -> Value:
        return self._source.call("sqrt", a)

    def number(self, number: float, like: Value) -> Value:
        return self._source.literal(number, like.dtype)


# -- orders

Step = Callable[[T, T], T]


@dataclass(frozen=True)
class Order:
    """Order in which a kernel takes the elements of a row.

    Attributes:
        lanes: Threads, or lanes of a vector, that share the row; each takes every ``lanes``-th element.
        accumulators: Sums that each lane has. The first elements of a lane go to them in turn.
        tail: Where the elements go that do not fill a turn: ``"spread"`` over the accumulators, to the ``"first"``, or
            for those that do not fill all lanes, to a sum of their own ``"before"`` the lanes.
        merge: How the sums of the lanes are combined: ``"serial"``, by ``"halves"`` or by ``"pairs"``.
    """

    lanes: int
    accumulators: int
    tail: str
    merge: str

    def fold(self, elements: Sequence[T], start: T, step: Step[T], combine: Step[T]) -> T:
        """Combine elements."""
        lanes, whole = self.lanes, len(elements)
        if self.tail == "before":
            whole -= whole % lanes
        sums = [self._lane(elements[lane:whole:lanes], start, step, combine) for lane in range(lanes)]
        if self.tail == "before":
            total = start
            for element in elements[whole:]:
                total = step(total, element)
            for value in sums:
                total = combine(total, value)
            return total
        return self._merge(sums, combine)

    def _lane(self, elements: Sequence[T], start: T, step: Step[T], combine: Step[T]) -> T:
        sums = [start] * self.accumulators
        turns = len(elements) - len(elements) % self.accumulators
        for index, element in enumerate(elements):
            place = index % self.accumulators if index < turns or self.tail == "spread" else 0
            sums[place] = step(sums[place], element)
        total = sums[0]
        for value in sums[1 : max(len(elements), 1)]:  # others add nothing
            total = combine(total, value)
        return total

    def _merge(self, sums: Sequence[T], combine: Step[T]) -> T:
        values = list(sums)
        if self.merge == "halves":
            while len(values) > 1:
                half = len(values) // 2
                values = [combine(values[i], values[i + half]) for i in range(half)]
        while len(values) > 1 and self.merge == "pairs":
            values = [combine(a, b) for a, b in zip(values[::2], values[1::2], strict=True)]
        total = values[0]
        for value in values[1:]:
            total = combine(total, value)
        return total


def _orders(count: int) -> list[Order]:
    """Orders that torch may use for a number of elements."""
    power = 1 << (count.bit_length() - 1)
    found = [Order(1, 1, "spread", "serial"), Order(1, 4, "spread", "serial"), Order(1, 4, "first", "serial")]
    # CUDA: neighbouring threads take neighbouring elements, and exchange their sums by shuffles.
    for lanes in dict.fromkeys((min(power, 32), power)):
        found += [Order(lanes, 4, "spread", merge) for merge in ("halves", "pairs")]
    # CPU: vectors of 256 or 512 bits
    found += [Order(lanes, 4, "before", "serial") for lanes in (4, 8, 16) if lanes <= count]
    return found


# -- reductions


@dataclass(frozen=True)
class Reduction:
    """How torch reduces a row.

    Attributes:
        kind: ``"sum"``, ``"mean"``, ``"prod"`` or ``"norm"``, the root of the sum of squares.
        order: Order of the elements.
        contracts: Whether a square and its sum are rounded once.
        divides: Whether a mean divides by the number of elements, and does not multiply by its reciprocal.
    """

    kind: str
    order: Order
    contracts: bool = False
    divides: bool = False

    def of_values(self, source: Source, elements: Sequence[Value]) -> Value:
        """The code for the elements of a row."""
        return self._apply(OfSource(source), elements)

    def of_tensors(self, elements: Sequence[torch.Tensor]) -> torch.Tensor:
        """The result for tensors of all first elements, of all second ones, and so on."""
        return self._apply(OfTensors(), elements)

    def _apply(self, on: Arithmetic[T], elements: Sequence[T]) -> T:
        if self.kind == "prod":
            return self.order.fold(elements, on.number(1.0, elements[0]), on.mul, on.mul)
        start = on.number(0.0, elements[0])
        if self.kind == "norm":
            step: Step[T] = lambda total, x: on.fma(x, x, total) if self.contracts else on.add(total, on.mul(x, x))  # noqa: E731
            return on.sqrt(self.order.fold(elements, start, step, on.add))
        total = self.order.fold(elements, start, on.add, on.add)
        if self.kind == "mean":
            count = on.number(float(len(elements)), elements[0])
            if self.divides:
                return on.div(total, count)
            return on.mul(total, on.div(on.number(1.0, elements[0]), count))
        return total


def _candidates(kind: str, count: int) -> list[Reduction]:
    orders = _orders(count)
    if kind == "norm":
        return [Reduction(kind, order, contracts=c) for c in (False, True) for order in orders]
    if kind == "mean":
        return [Reduction(kind, order, divides=d) for d in (False, True) for order in orders]
    return [Reduction(kind, order) for order in orders]


_TORCH: dict[str, Callable[[torch.Tensor, int], torch.Tensor]] = {
    "sum": lambda x, dim: x.sum(dim),
    "mean": lambda x, dim: x.mean(dim),
    "prod": lambda x, dim: x.prod(dim),
    "norm": lambda x, dim: torch.linalg.vector_norm(x, dim=dim),
}
_FOUND: dict[Hashable, object] = {}
"""Results of trials, by operation, device, type and layout."""


def _once(key: Hashable, find: Callable[[], T]) -> T:
    """The result of a trial, which is made once in a process: within a recording there could be none."""
    if key not in _FOUND:
        _FOUND[key] = find()
    found: T = _FOUND[key]  # type: ignore[assignment]
    return found


def find_reduction(kind: str, tensor: torch.Tensor, dim: int) -> Reduction | None:
    """How torch reduces a dimension of tensors like this one; None if that is not known.

    Args:
        kind: Kind of :class:`Reduction`.
        tensor: The tensor; its values do not matter.
        dim: The dimension.
    """
    sizes, strides = tuple(tensor.shape), tensor.stride()

    def find() -> Reduction | None:
        length = 1 + sum((size - 1) * stride for size, stride in zip(sizes, strides, strict=True))
        numbers = _random(length, tensor).as_strided(sizes, strides)
        expected = _TORCH[kind](numbers, dim)
        columns = numbers.unbind(dim)
        return next((c for c in _candidates(kind, sizes[dim]) if _same(c.of_tensors(columns), expected)), None)

    return _once((kind, tensor.device, tensor.dtype, sizes, strides, dim), find)


# -- other operations


def divides_by_reciprocal(device: torch.device, dtype: torch.dtype) -> bool:
    """Whether torch divides by a number of the host by multiplying with its reciprocal."""

    def find() -> bool:
        numbers = _random(4096, torch.empty(0, device=device, dtype=dtype))
        return all(_same(numbers / n, numbers * (1.0 / torch.tensor(n, dtype=dtype)).item()) for n in (0.3, 7.0, 1.7e3))

    return _once(("division", device, dtype), find)


def fuses_alpha(device: torch.device, dtype: torch.dtype) -> bool:
    """Whether torch rounds once in ``add(a, b, alpha=...)``."""

    def find() -> bool:
        a, b = _random(8192, torch.empty(0, device=device, dtype=dtype)).chunk(2)
        return not _same(torch.add(a, b, alpha=0.3), a + 0.3 * b)

    return _once(("alpha", device, dtype), find)


CROSS = ("plain", "first", "second")
"""Which of two products in a cross product is contracted with their difference."""


def cross(on: Arithmetic[T], variant: str, a: T, b: T, c: T, d: T) -> T:
    """``a * b - c * d`` with one of the two products contracted, or none."""
    if variant == "first":
        return on.fma(a, b, on.neg(on.mul(c, d)))
    if variant == "second":
        return on.fma(on.neg(c), d, on.mul(a, b))
    return on.sub(on.mul(a, b), on.mul(c, d))


def cross_variants(device: torch.device, dtype: torch.dtype) -> tuple[str, str, str] | None:
    """The variant of :func:`cross` in each component of torch's cross product; None if it is none of them."""

    def find() -> tuple[str, str, str] | None:
        x, y = _random(24576, torch.empty(0, device=device, dtype=dtype)).view(2, -1, 3)
        expected = torch.linalg.cross(x, y)
        found = []
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            terms = x[:, j], y[:, k], x[:, k], y[:, j]
            found += [v for v in CROSS if _same(cross(OfTensors(), v, *terms), expected[:, i])][:1]
        return (found[0], found[1], found[2]) if len(found) == 3 else None

    return _once(("cross", device, dtype), find)


def _random(count: int, like: torch.Tensor) -> torch.Tensor:
    """Random numbers of all magnitudes near one, from a generator of its own."""
    generator = torch.Generator(like.device).manual_seed(1)
    shape = (count,)
    signs = torch.randn(shape, generator=generator, device=like.device, dtype=like.dtype)
    return signs * torch.exp(torch.randn(shape, generator=generator, device=like.device, dtype=like.dtype))


def _same(one: torch.Tensor, two: torch.Tensor) -> bool:
    return bool(torch.equal(one, two)) and math.prod(one.shape) > 0
