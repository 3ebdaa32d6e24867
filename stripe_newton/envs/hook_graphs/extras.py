# SPDX-License-Identifier: Apache-2.0
"""Extras of a recorded hook: what it adds to ``env.extras``, copied to new tensors after each replay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from .host_values import NotRecordable

__all__ = ["Extras", "ExtrasMemory", "added_extras", "copy_extras", "memory_like", "publish_extras", "tensors_of"]

Extras = dict[str, Any]


def copy_extras(extras: Extras) -> Extras:
    """A copy of the dict and of the dicts in it, with the same tensors."""
    return {k: copy_extras(v) if isinstance(v, dict) else v for k, v in extras.items()}


class _Fresh(dict):
    """Entries of a dict by which a hook has replaced another one."""


_UNCHANGED = object()
"""Stands for an entry that the hook has taken over from the dict before."""


def added_extras(before: Extras, given: Extras, after: Extras) -> Extras:
    """Entries of ``after`` that are not in ``before``, or not the same; in dicts, too.

    Args:
        before: Copy of the extras before the hook, of :func:`copy_extras`.
        given: Dicts in the extras that the hook was given, by key, to find those that it replaced.
        after: The extras after the hook.
    """
    found: Extras = {}
    for key, value in after.items():
        old = before.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            if id(value) != id(given.get(key)):
                found[key] = _Fresh({k: _UNCHANGED if k in old and v is old[k] else v for k, v in value.items()})
                continue
            inner = added_extras(old, {k: v for k, v in value.items() if isinstance(v, dict)}, value)
            if inner:
                found[key] = inner
        elif key not in before or value is not old:
            found[key] = value
    return found


class ExtrasMemory:
    """Memory of its own for the tensors that a recorded hook adds to the extras.

    Graphs of one environment share a pool of memory for what is temporary in each. Tensors in it do not last: the next
    graph may write there before the end of the step, when the extras are read.
    """

    def __init__(self, log_memory: Callable[[torch.Tensor], torch.Tensor]) -> None:
        """Prepare.

        Args:
            log_memory: Makes memory like a tensor of the log, which is copied in every step.
        """
        self.tensors: dict[str, torch.Tensor] = {}
        self._log_memory = log_memory

    def reserve(self, added: Extras, path: str = "extras") -> None:
        """Allocate memory for the tensors of some extras. Call it outside of recordings."""
        for key, value in added.items():
            place = f"{path}[{key!r}]"
            if isinstance(value, dict):
                self.reserve(value, place)
            elif isinstance(value, torch.Tensor) and not _like(self.tensors.get(place), value):
                self.tensors[place] = (self._log_memory if path == "extras['log']" else memory_like)(value)

    def keep(self, added: Extras, stays: Callable[[torch.Tensor], bool], path: str = "extras") -> Extras:
        """Copy tensors to this memory, within a recording.

        Args:
            added: The extras.
            stays: Whether a tensor lies in memory that stays anyway.
            path: Name of the extras.

        Returns:
            The same extras with the tensors of this memory.

        Raises:
            NotRecordable: if there is none for a tensor.
        """
        kept = type(added)()
        for key, value in added.items():
            place = f"{path}[{key!r}]"
            if isinstance(value, dict):
                kept[key] = self.keep(value, stays, place)
            elif isinstance(value, torch.Tensor) and not stays(value):
                home = self.tensors.get(place)
                if home is None or not _like(home, value):
                    raise NotRecordable(f"{place} is not the same kind of tensor in every step")
                kept[key] = home.copy_(value)
            else:
                kept[key] = value
        return kept


def memory_like(value: torch.Tensor) -> torch.Tensor:
    """Contiguous memory like a tensor, on its own."""
    return torch.empty_like(value, memory_format=torch.contiguous_format)


def _like(one: torch.Tensor | None, two: torch.Tensor) -> bool:
    return one is not None and one.shape == two.shape and one.dtype == two.dtype and one.device == two.device


def publish_extras(extras: Extras, added: Extras, log: bool = False) -> None:
    """Add the entries of a recorded hook to the extras of a step.

    Tensors of the log are copied once at the end of the step, others here, as the next replay overwrites them.
    """
    for key, value in added.items():
        if isinstance(value, _Fresh):
            current: Extras = dict(extras.get(key) or {})
            extras[key] = {}
            entries = {k: current.get(k) if v is _UNCHANGED else v for k, v in value.items()}
            publish_extras(extras[key], entries, key == "log")
        elif isinstance(value, dict):
            publish_extras(extras.setdefault(key, {}), value, log or key == "log")
        else:
            extras[key] = value.clone() if isinstance(value, torch.Tensor) and not log else value


def tensors_of(extras: Extras, path: str = "") -> dict[str, torch.Tensor]:
    """Copies of all numbers and tensors in extras, by path."""
    found: dict[str, torch.Tensor] = {}
    for key, value in extras.items():
        if isinstance(value, dict):
            found |= tensors_of(value, f"{path}{key}/")
        elif isinstance(value, torch.Tensor):
            found[f"{path}{key}"] = value.detach().clone()
        elif isinstance(value, (bool, int, float)):
            found[f"{path}{key}"] = torch.tensor(value)
    return found
