# SPDX-License-Identifier: Apache-2.0
"""Chain: operations on rows that one kernel runs, a thread for each row."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import torch

from .memory import Hazard, Memory, Region
from .plan import Plan
from .source import Source

__all__ = ["Chain", "ChainCode"]

MAX_STATEMENTS, MAX_REGIONS = 4000, 256
"""Size of a chain at which the next one begins: compilers take long for large functions, and arguments are limited."""


@dataclass(frozen=True)
class ChainCode:
    """The code of a chain, and the memory that it is to run on.

    Attributes:
        body: Statements of C++ for row ``row``, with pointers ``p0``, ``p1`` and so on.
        addresses: Addresses for these pointers.
        rows: Number of rows.
        operations: Number of operations of torch that it stands for.
        storages: Memory that it reads or writes, to be kept alive as long as it may be launched.
    """

    body: str
    addresses: tuple[int, ...]
    rows: int
    operations: int
    storages: tuple[torch.UntypedStorage, ...]

    @property
    def digest(self) -> str:
        """Name of the code: equal code has an equal name."""
        return hashlib.sha256(self.body.encode()).hexdigest()[:16]


class Chain:
    """Operations that wait to be launched as one kernel.

    Attributes:
        rows: Number of rows.
        operations: Number of operations.
        memory: Memory that they read and write.
    """

    def __init__(self, rows: int, cuda: bool):
        self.rows, self.operations = rows, 0
        self._source = Source(cuda)
        self.memory = Memory(self._source)

    def add(self, plan: Plan, make: Callable[[torch.Tensor | None], torch.Tensor]) -> torch.Tensor:
        """Add an operation.

        Args:
            plan: What it does to a row.
            make: Makes the tensor of the result, like a tensor without memory, or returns the target.

        Raises:
            Hazard: if it must begin the next chain.
            Unsupported: if no chain can hold it.
        """
        if len(self._source.lines) > MAX_STATEMENTS or self.memory.size > MAX_REGIONS:
            raise Hazard("the chain is long enough")
        target = [plan.result(plan.target)] if plan.target is not None and plan.scattered is None else []
        self.memory.admit([*plan.inputs, *target], self.rows)
        if plan.gathered is not None:
            self.memory.admit_gather(plan.gathered)
        read = [self.memory.read(access) for access in plan.inputs]
        if plan.gathered is not None:
            read.append(self.memory.gather(plan.gathered, read))
        if plan.scattered is not None:
            self.memory.admit_scatter(plan.scattered, plan.inputs, read)
        values = plan.compute(self._source, read)
        made = make(plan.like)
        self.operations += 1
        if plan.scattered is not None:
            self.memory.scatter(plan.scattered, read, values)
            return made
        if plan.target is None:
            self.memory.add_made(made)
        self.memory.write(plan.result(made), values)
        return made

    def finish(self) -> ChainCode | None:
        """The code of the chain; None if nobody will read what it has computed."""
        stores = self.memory.stores()
        if not stores:
            return None
        lines: list[str] = []
        regions: dict[int, tuple[str, Region]] = {}
        for name, region, pitch in self.memory.pointers():
            pointer = regions.setdefault(region.number, (f"p{len(regions)}", region))[0]
            lines.append(f"char* const {name} = reinterpret_cast<char*>({pointer}) + row * {pitch}ll;")
        lines += self._source.lines
        lines += [f"{s.place} = {s.value};" for s in stores if not s.first_row_only]
        first = [f"    {s.place} = {s.value};" for s in stores if s.first_row_only]
        lines += ["if (row == 0) {", *first, "}"] if first else []
        used = [region for _, region in regions.values()]
        storages = [storage for region in used for storage in region.alive()]
        return ChainCode(
            "\n".join(lines), tuple(region.origin for region in used), self.rows, self.operations, tuple(storages)
        )
