# SPDX-License-Identifier: Apache-2.0
"""Constant tables: arrays of a model's topology as C++ source, which a block of threads keeps in shared memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

__all__ = ["ConstantTables"]

_INTEGERS = {
    "unsigned char": (0, 2**8, 1), "signed char": (-(2**7), 2**7, 1), "short": (-(2**15), 2**15, 2),
    "int": (-(2**31), 2**31, 4), "unsigned long long": (0, 2**64, 8),
}  # fmt: skip
"""Types of C++ with their least value, the first beyond the largest, and their size in bytes; the smallest first."""
_REAL_BYTES = 4
_MOST_IN_RULES = 2**30
_MOST_SHARED = 4096
"""Tables up to this size together are kept in shared memory, so that much is left for worlds [bytes]."""


@dataclass(frozen=True)
class ConstantTables:
    """Tables of a model by name. In C++ each is a function of the index.

    Few of a robot's tables are without a rule: its joints are numbered in the order of their degrees of freedom, all of
    them but the first are hinges, and so on. The function of such a table computes the element, from which the compiler
    knows more, and which takes less than a look into memory.
    """

    integers: Mapping[str, Iterable[int]]
    reals: Mapping[str, Iterable[float]]

    @cached_property
    def _arrays(self) -> dict[str, tuple[str, int, list[str]]]:
        """Type, size of an element and elements of each table, the largest elements first so that no gap is between."""
        arrays = {name: _integers([int(v) for v in values]) for name, values in self.integers.items()}
        arrays |= {n: ("real", _REAL_BYTES, [repr(float(v)) for v in values]) for n, values in self.reals.items()}
        return dict(sorted(arrays.items(), key=lambda item: -item[1][1]))

    @cached_property
    def _rules(self) -> dict[str, str]:
        """Expressions of the tables that follow a rule."""
        rules = {name: rule_of([int(v) for v in values]) for name, values in self.integers.items()}
        for name, values in self.reals.items():
            reals = {float(v) for v in values} or {0.0}
            if len(reals) == 1:
                rules[name] = f"(real){reals.pop()!r}"
        return {name: rule for name, rule in rules.items() if rule}

    @cached_property
    def _kept(self) -> set[str]:
        """The tables for shared memory: the smallest, as many as there is room for."""
        sizes = sorted((size * max(1, len(values)), name) for name, (_, size, values) in self._looked_up)
        kept, total = set(), 0
        for size, name in sizes:
            total += size
            if total <= _MOST_SHARED:
                kept.add(name)
        return kept

    @property
    def _looked_up(self) -> list[tuple[str, tuple[str, int, list[str]]]]:
        """Those of :attr:`_arrays` that follow no rule."""
        return [(name, array) for name, array in self._arrays.items() if name not in self._rules]

    @cached_property
    def shared_size(self) -> int:
        """Shared memory of a block for them [bytes]."""
        total = sum(size * max(1, len(v)) for n, (_, size, v) in self._arrays.items() if n in self._kept)
        return max(16, -(-total // 16) * 16)

    def source(self) -> str:
        """The struct of those in shared memory, the others, and a function for each."""
        members, values, others, functions = [], [], [], []
        for name, (kind, _, elements) in self._arrays.items():
            count, content = max(1, len(elements)), ", ".join(elements) or "0"  # an array has one element at least
            result = "int" if kind in ("unsigned char", "signed char", "short") else kind
            if name in self._rules:
                functions.append(f"FN {result} {name}(int i) {{ return {self._rules[name]}; }}")
                continue
            if name in self._kept:
                members.append(f"    {kind} {name}[{count}];")
                values.append(f"    {{{content}}},")
                place = f"tables().{name}"
            else:
                others.append(f"TABLE {kind} all_of_{name}[] = {{{content}}};")
                place = f"all_of_{name}"
            functions.append(f"FN {result} {name}(int i) {{ return {place}[i]; }}")
        if not members:
            members, values = ["    int none[4];"], ["    {0},"]
        return "\n".join(
            [
                *("struct alignas(16) Tables {", *members, "};"),
                *("TABLE Tables given_tables = {", *values, "};"),
                *others,
                _PLACE,
                *functions,
            ]
        )


_PLACE = """\
#if IN_SHARED && defined(__CUDA_ARCH__)
FN Tables& tables() {
    extern __shared__ char dynamic_smem_base[];
    return *(Tables*)dynamic_smem_base;
}
// All threads of a block copy the tables to its shared memory.
FN void share_tables() {
    for (int i = threadIdx.x; i < sizeof(Tables) / 4; i += blockDim.x)
        ((unsigned*)&tables())[i] = ((const unsigned*)&given_tables)[i];
    __syncthreads();
}
#else
FN const Tables& tables() { return given_tables; }
FN void share_tables() {}
#endif"""


def rule_of(values: Sequence[int]) -> str:
    """C++ expression of the element with the index ``i``: a line, or one up to some index and another from there on.

    Returns:
        The expression; empty where there is none, or where numbers may not fit an ``int``.
    """
    if not values:
        return "0"
    steps = [b - a for a, b in itertools.pairwise(values)]
    if max(map(abs, values)) >= _MOST_IN_RULES or max(map(abs, steps), default=0) * len(values) >= _MOST_IN_RULES:
        return ""
    # The second line begins where the last steps are equal, and elements before it must be on one line, too.
    start = max((i + 1 for i, (a, b) in enumerate(itertools.pairwise(steps)) if a != b), default=0)
    if any(a != b for a, b in itertools.pairwise(steps[: max(0, start - 1)])):
        return ""
    second = _line(values[start], steps[-1] if steps else 0, start)
    return f"i < {start} ? {_line(values[0], steps[0] if start > 1 else 0, 0)} : {second}" if start else second


def _line(first: int, step: int, start: int) -> str:
    at_zero = first - step * start
    return str(at_zero) if step == 0 else f"{step} * i + {at_zero}"


def _integers(values: list[int]) -> tuple[str, int, list[str]]:
    least, most = min(values, default=0), max(values, default=0)
    kind, size = next((k, size) for k, (low, high, size) in _INTEGERS.items() if low <= least and most < high)
    return kind, size, [f"{v}ull" if size == 8 else str(v) for v in values]
