# SPDX-License-Identifier: Apache-2.0
"""Carried state: tensors that hooks bind anew in each step, kept in memory that a graph can read and write.

A graph reads the memory that a tensor had when the graph was recorded. A hook that says ``self.prev = self.actions;
self.actions = new`` makes new tensors instead. So each path has one tensor for good, its *home*: after a hook has run,
the values of its new tensors are copied to the homes, all reads before all writes, and the paths are bound to the homes
again. The copies are recorded with the hook. This is how a loop carries state from one iteration to the next.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import torch

from .reachable import Path, Scan, assign, fast_slot, path_name, scan, size_of, storage_of, value_at

__all__ = ["CarriedState", "NotSteady", "moved_paths"]


class NotSteady(RuntimeError):
    """State changed in a way that no fixed memory can follow, such as by a new shape or a longer list."""


def moved_paths(before: Scan, after: Scan) -> set[Path]:
    """Paths whose tensor is at other memory than before.

    Raises:
        NotSteady: if a tensor came, went, or changed its shape or type.
    """
    moved = set()
    for path in before.tensors.keys() - after.tensors.keys():
        raise NotSteady(f"{path_name(path)} is a tensor no more")
    for path, tensor in after.tensors.items():
        old = before.tensors.get(path)
        if old is None:
            raise NotSteady(f"{path_name(path)} is a new tensor")
        if old.shape != tensor.shape or old.dtype != tensor.dtype or old.device != tensor.device:
            shapes = f"{old.dtype} {tuple(old.shape)} to {tensor.dtype} {tuple(tensor.shape)}"
            raise NotSteady(f"{path_name(path)} changes from {shapes}".replace("torch.", ""))
        if _repeats(old) != _repeats(tensor):
            raise NotSteady(f"{path_name(path)} is sometimes an expanded tensor")
        if not _same_memory(old, tensor):
            moved.add(path)
    return moved


class CarriedState:
    """The homes of all tensors that an environment's hooks reach.

    Attributes:
        homes: The home of each path.
        places: Container, key and home of each path, of :func:`.reachable.fast_slot`.
    """

    places: list[tuple[object, str | int, torch.Tensor]]

    def __init__(self, env: object, skip: Collection[str], fixed: Iterable[torch.Tensor], moved: Collection[Path]):
        """Make homes, and bind the paths to them.

        Args:
            env: The environment.
            skip: Attributes that are left out.
            fixed: Tensors of the simulation, which hooks may view.
            moved: Paths that hooks bind anew. Their homes are copies, as others may have kept the tensors there now.

        Raises:
            NotSteady: if a path that is bound anew shares memory with one that is not.
        """
        self._env, self._skip = env, skip
        self._fixed = {storage_of(t) for t in fixed}
        now = scan(env, skip)
        missing = [p for p in moved if p not in now.tensors]
        if missing:
            raise NotSteady(f"{path_name(missing[0])} is not always a tensor")
        self.homes = dict(now.tensors)
        self.homes.update(self._copies({p: now.tensors[p] for p in moved}))
        for path in moved:
            assign(env, path, self.homes[path])
        self._find_holders()

    def _copies(self, moved: Mapping[Path, torch.Tensor]) -> dict[Path, torch.Tensor]:
        """Copies of tensors; those that shared memory share it again."""
        stays = {storage_of(t): p for p, t in self.homes.items() if p not in moved and t.numel()}
        storages: dict[int, torch.UntypedStorage] = {}
        copies = {}
        for path, tensor in moved.items():
            place = storage_of(tensor)
            if tensor.numel() and place in self._fixed:
                raise NotSteady(f"{path_name(path)} is sometimes memory of the simulation")
            if tensor.numel() and place in stays:
                raise NotSteady(f"{path_name(path)} sometimes shares memory with {path_name(stays[place])}")
            if place not in storages:
                storages[place] = tensor.untyped_storage().clone()
            copy = torch.empty(0, dtype=tensor.dtype, device=tensor.device)
            copies[path] = copy.set_(storages[place], tensor.storage_offset(), tensor.shape, tensor.stride())
        return copies

    def _find_holders(self) -> None:
        found = scan(self._env, self._skip)
        self._slots = {path: fast_slot(*found.holders[path]) for path in self.homes}
        self.places = [(*self._slots[path], home) for path, home in self.homes.items()]
        self._links = [(*fast_slot(holder, key), value) for holder, key, value in found.links]
        self._sizes = [(container, size_of(container)) for container, _ in found.contents]

    def holds(self, tensor: torch.Tensor) -> bool:
        """Whether a tensor is in persistent memory: that of a home or of the simulation."""
        return storage_of(tensor) in self._fixed or storage_of(tensor) in map(storage_of, self.homes.values())

    def _look(self) -> Scan:
        """The tensors of all paths as they are now.

        Where all containers are those of the last walk, no other walk is needed, and the places of tensors are known.
        """
        found = Scan()
        if all(value_at(holder, key) is value for holder, key, value in self._links) and all(
            size_of(container) == size for container, size in self._sizes
        ):
            for path, (holder, key) in self._slots.items():
                value = value_at(holder, key)
                if not isinstance(value, torch.Tensor):
                    break
                found.tensors[path] = value
            else:
                return found
        return scan(self._env, self._skip)

    def replaced(self) -> str:
        """Name of a tensor that is not at its home, so that code outside the hooks has bound it; empty for none."""
        pairs = zip(self.places, self.homes, strict=True)
        return next((path_name(path) for (holder, key, home), path in pairs if value_at(holder, key) is not home), "")

    def settle(self) -> set[Path]:
        """Copy tensors that were bound since the last call to their homes, and bind their paths to the homes again.

        Returns:
            The paths that were bound anew.

        Raises:
            NotSteady: if that is impossible; everything is then bound as it was found.
        """
        now = self._look()
        if all(tensor is self.homes.get(path) for path, tensor in now.tensors.items()) and not now.contents:
            return set()
        moved = moved_paths(Scan(tensors=self.homes), now)
        self._check_sharing(now, moved)
        pairs = [(self.homes[p], now.tensors[p]) for p in moved if self.homes[p].numel()]
        written = {storage_of(home) for home, _ in pairs}
        # All reads come before all writes: a value that lies in memory that is written now is copied out of the way.
        values = [value.clone() if storage_of(value) in written else value for _, value in pairs]
        for (home, _), value in zip(pairs, values, strict=True):
            _single(home, home).copy_(_single(value, home))
        for path, tensor in now.tensors.items():
            if tensor is not self.homes[path]:
                assign(self._env, path, self.homes[path])
        if now.contents:  # of a walk: containers are other ones than before
            self._find_holders()
        return moved

    def _check_sharing(self, now: Scan, moved: Collection[Path]) -> None:
        """Check that tensors share memory exactly where their homes do, so that writes in place stay what they are."""
        home_of: dict[int, tuple[int, Path]] = {}
        value_of: dict[int, tuple[int, Path]] = {}
        for path, tensor in now.tensors.items():
            if not tensor.numel():
                continue
            value, home = storage_of(tensor), storage_of(self.homes[path])
            if path in moved and home in self._fixed:
                raise NotSteady(f"{path_name(path)} is memory of the simulation at first, and a new tensor then")
            if path in moved and value in self._fixed:
                raise NotSteady(f"{path_name(path)} is memory of the simulation, in place of a tensor of its own")
            for table, key, other in ((home_of, value, home), (value_of, home, value)):
                there = table.setdefault(key, (other, path))
                if there[0] != other:
                    names = f"{path_name(path)} and {path_name(there[1])}"
                    raise NotSteady(f"{names} do not always share memory")


def _same_memory(a: torch.Tensor, b: torch.Tensor) -> bool:
    return a is b or (a.data_ptr() == b.data_ptr() and a.stride() == b.stride())


def _repeats(tensor: torch.Tensor) -> list[bool]:
    """Dimensions in which all entries are the same number in memory, as ``expand`` makes them."""
    return [stride == 0 and size > 1 for size, stride in zip(tensor.shape, tensor.stride(), strict=True)]


def _single(tensor: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    """A tensor without the repetitions of ``like``, as memory that repeats cannot be the target of a copy."""
    for dim, repeats in enumerate(_repeats(like)):
        tensor = tensor.narrow(dim, 0, 1) if repeats else tensor
    return tensor
