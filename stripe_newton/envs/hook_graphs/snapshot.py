# SPDX-License-Identifier: Apache-2.0
"""Snapshot of all that hooks can change, to run a hook twice from the same state and to compare the results."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import torch

from .reachable import Scan, path_name, scan

__all__ = ["Results", "Snapshot", "as_close_as_repeats", "first_difference"]

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
    for name in one.keys() ^ two.keys():
        return name
    names = list(one)
    for name in names:
        if one[name].shape != two[name].shape or one[name].dtype != two[name].dtype:
            return name
    if not names:
        return ""
    # Floats are compared as bits, where NaN is the same as NaN. The host waits for the device once, not once a name.
    device = next((t.device for t in one.values() if t.device.type != "cpu"), torch.device("cpu"))
    same = [(_bits(one[n]) == _bits(two[n])).all().to(device, non_blocking=True) for n in names]
    return next((name for name, equal in zip(names, torch.stack(same).tolist(), strict=True) if not equal), "")


def _bits(values: torch.Tensor) -> torch.Tensor:
    return values.contiguous().view(torch.uint8) if values.dim() else values.reshape(1).view(torch.uint8)


def as_close_as_repeats(saved: Snapshot, replayed: Results, eager: Results, again: Results) -> bool:
    """Whether a replay differs from a hook no more than the hook from itself, where that has rounding of its own."""
    if replayed.keys() != eager.keys() or eager.keys() != again.keys():
        return False
    for name in eager:
        if torch.equal(replayed[name], eager[name]):
            continue
        if torch.equal(eager[name], again[name]):
            return False
        values = [r[name] if name.startswith("extras") else saved.typed(name, r[name]) for r in (replayed, eager)]
        one, two = values
        if not one.is_floating_point() or not torch.allclose(one, two, rtol=1e-5, atol=1e-6, equal_nan=True):
            return False
    return True


def _storages(found: Scan, arrays: Mapping[str, torch.Tensor]) -> dict[str, torch.UntypedStorage]:
    """Distinct storages by the name of the first tensor in them.

    Two that begin at the same address may differ in their sizes: an array of Warp's is a storage of its own within the
    block of memory that it lies in.
    """
    storages: dict[tuple[int, int], tuple[str, torch.UntypedStorage]] = {}
    named: Iterable[tuple[str, torch.Tensor]] = [
        *((path_name(p), t) for p, t in found.tensors.items()),
        *arrays.items(),
    ]
    for name, tensor in named:
        storage = tensor.untyped_storage()
        if storage.nbytes():
            storages.setdefault((storage.data_ptr(), storage.nbytes()), (name, storage))
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
