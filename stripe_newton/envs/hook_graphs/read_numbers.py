# SPDX-License-Identifier: Apache-2.0
"""Read numbers: plain numbers that the code of a hook may read, and which a recording holds as they were."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from .carried_state import NotSteady
from .host_values import ExecutedCode, location_of_name
from .reachable import Path, Scan, fast_slot, path_name, value_at

__all__ = ["ReadNumbers"]


class ReadNumbers:
    """Numbers that a hook may read, with their values of the run that was watched last."""

    def __init__(self, code: ExecutedCode, location: str):
        """Start with none.

        Args:
            code: Code that the hook has executed; more is added as it runs.
            location: File and line of the hook, for reasons that have no nearer place.
        """
        self._code, self._location = code, location
        self._numbers: list[tuple[object, str | int, object, str]] = []

    def watch(self, found: Scan) -> None:
        """Note the numbers among those found whose names the code reads, and those of its modules."""
        names = self._code.names
        self._numbers = []
        for path, value in found.numbers.items():
            if _name_of(path) in names and path in found.holders:
                self._numbers.append((*fast_slot(*found.holders[path]), value, path_name(path)))
        for name, scope in self._code.global_numbers().items():
            self._numbers.append((scope, name, scope[name], name))

    def clear(self) -> None:
        """Forget all numbers."""
        self._numbers.clear()

    @property
    def places(self) -> list[tuple[object, str | int, object]]:
        """Container, key and value of each number."""
        return [number[:3] for number in self._numbers]

    def change_since(self) -> str:
        """Reason, with its place, if a number is not what it was when the hook was watched; empty if all are.

        Raises:
            NotSteady: if it is a tensor now, which has no home yet.
        """
        for holder, key, value, name in self._numbers:
            now = value_at(holder, key)
            if isinstance(now, torch.Tensor):
                raise NotSteady(f"{self._location}: {name} is a number first and a tensor then")
            if now is not value and now != value:
                where = self._place_of(name.rpartition(".")[2].partition("[")[0])
                return f"{where}: reads {name}, a number that changes from {value!r} to {now!r}"
        return ""

    def changes_within(self, before: Scan, after: Scan) -> Iterator[str]:
        """Reasons, with their places, for the numbers that a run of the hook has changed, read or not."""
        for path, value in after.numbers.items():
            old = before.numbers.get(path)
            if path not in before.numbers or (old is not value and old != value):
                where = self._place_of(_name_of(path))
                if path[-1] == "len()":
                    yield f"{where}: {path_name(path[:-1])} changes its length from {old} to {value}"
                else:
                    yield f"{where}: {path_name(path)} changes on the host, from {old!r} to {value!r}"

    def _place_of(self, name: str) -> str:
        """File and line where the code names something; those of the hook where it does not."""
        return location_of_name(self._code, name) or self._location


def _name_of(path: Path) -> str:
    """Name by which source code reads the value at a path, or the container that holds it."""
    return next((k for k in reversed(path) if isinstance(k, str) and k != "len()"), "")
