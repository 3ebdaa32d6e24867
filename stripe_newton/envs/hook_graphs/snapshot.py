# SPDX-License-Identifier: Apache-2.0
"""Snapshot of all that hooks can change, to run a hook twice from the same state and to compare the results."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import torch

from .reachable import Scan, path_name, scan, storage_of

__all__ = ["Results", "Snapshot", "first_difference"]

Results = dict[str, torch.Tensor]
"""Memory after a hook has run: bytes of storages by name, states of random generators, tensors of the extras."""


class Snapshot:
    """Values of all tensors, containers, numbers and random generators that hooks reach, and of the simulation."""

    def __init__(self, env: object, skip: Collection[str], arrays: Mapping[str, torch.Tensor], device: str):
        """Copy everything.

        Args:
            env: The environment.
            skip: Attributes that are left out.
            arrays: Memory of the simulation by name.
            device: Device whose default random generator is part of it.
        """
        self._scan, self._device = scan(env, skip), device
        self._storages = _storages(self._scan, arrays)
        self._saved = {name: storage.clone() for name, storage in self._storages.items()}
        self._random = self._generators()

    def restore(self) -> None:
        """Bring everything back in place."""
        self._scan.restore()
        self.restore_memory()
        self.restore_random()

    def restore_memory(self) -> None:
        """Bring the values of tensors and arrays back, wherever attributes are bound."""
        for name, storage in self._storages.items():
            storage.copy_(self._saved[name])

    def restore_random(self) -> None:
        """Bring the random generators back."""
        for generator, state in zip(self._scan.generators, self._random[1:], strict=True):
            generator.set_state(state)
        _set_default_generator(self._device, self._random[0])

    def results(self) -> Results:
        """The same memory as it is now, copied."""
        found = {name: _bytes(storage) for name, storage in self._storages.items()}
        return found | {f"random generator {i}": state for i, state in enumerate(self._generators())}

    def typed(self, name: str, values: torch.Tensor) -> torch.Tensor:
        """Bytes of a storage in results as numbers of the first tensor that lies in it."""
        for path, tensor in self._scan.tensors.items():
            if path_name(path) == name:
                return values.view(tensor.dtype) if values.numel() % tensor.dtype.itemsize == 0 else values
        return values.view(torch.float32) if values.numel() % 4 == 0 else values

    def _generators(self) -> list[torch.Tensor]:
        return [_default_generator(self._device), *(g.get_state().clone() for g in self._scan.generators)]


def first_difference(one: Results, two: Results) -> str:
    """Name of the first entry of two results that is not the same, bit for bit; empty for none."""
    for name in one.keys() | two.keys():
        if name not in one or name not in two or not torch.equal(one[name], two[name]):
            return name
    return ""


def _storages(found: Scan, arrays: Mapping[str, torch.Tensor]) -> dict[str, torch.UntypedStorage]:
    """Distinct storages by the name of the first tensor in them."""
    storages: dict[int, tuple[str, torch.UntypedStorage]] = {}
    named: Iterable[tuple[str, torch.Tensor]] = [
        *((path_name(p), t) for p, t in found.tensors.items()),
        *arrays.items(),
    ]
    for name, tensor in named:
        if tensor.untyped_storage().nbytes():
            storages.setdefault(storage_of(tensor), (name, tensor.untyped_storage()))
    return dict(storages.values())


def _bytes(storage: torch.UntypedStorage) -> torch.Tensor:
    return torch.empty(0, dtype=torch.uint8, device=storage.device).set_(storage).clone()


def _default_generator(device: str) -> torch.Tensor:
    return torch.get_rng_state() if device == "cpu" else torch.cuda.get_rng_state(device)


def _set_default_generator(device: str, state: torch.Tensor) -> None:
    if device == "cpu":
        torch.set_rng_state(state)
    else:
        torch.cuda.set_rng_state(state, device)
