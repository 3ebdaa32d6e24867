# SPDX-License-Identifier: Apache-2.0
"""Reachable state: tensors, numbers and containers that hooks can reach from their environment, by path."""

from __future__ import annotations

import enum
import operator
import sys
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from operator import itemgetter
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import torch

from stripe_newton.noise import NoiseModel

__all__ = [
    "NOTHING",
    "Path",
    "Places",
    "Scan",
    "assign",
    "fast_slot",
    "path_name",
    "scan",
    "size_of",
    "storage_of",
    "value_at",
]

Path: TypeAlias = "tuple[str | int, ...]"
"""Keys from the environment to a value: names of attributes, keys of dicts, indices of lists."""

NOTHING = object()
"""Stands for no value."""
_OPAQUE = {
    "torch", "warp", "newton", "numpy", "gymnasium", "pxr", "stripe_newton", "stripe_kernels", "mujoco", "mujoco_warp",
    "rsl_rl", "tensordict", "matplotlib", "PIL",
}  # fmt: skip
"""Packages whose objects are not looked into: the simulation's are, as far as hooks write them, saved as arrays."""
_NUMBERS = (bool, int, float, complex, str, bytes, type(None), enum.Enum, np.generic, torch.dtype, torch.device)
_SMALL = 4096
"""Largest NumPy array that counts as numbers."""


@dataclass
class Scan:
    """Results of a walk over everything that the environment refers to.

    Attributes:
        tensors: Tensors by path.
        numbers: Plain values by path, with small NumPy arrays as bytes, lengths of containers and class attributes.
        holders: For each number and tensor, the container that holds it and its key there, for quick comparisons.
        generators: Random generators of torch.
        contents: All containers, each with a shallow copy of what it holds.
        links: Containers and ``None``, each with what holds it and the key there.
    """

    tensors: dict[Path, torch.Tensor] = field(default_factory=dict)
    numbers: dict[Path, object] = field(default_factory=dict)
    holders: dict[Path, tuple[object, str | int]] = field(default_factory=dict)
    generators: list[torch.Generator] = field(default_factory=list)
    contents: list[tuple[object, object]] = field(default_factory=list)
    links: list[tuple[object, str | int, object]] = field(default_factory=list)

    def restore(self) -> None:
        """Give all containers what they held, and so all attributes their values."""
        for holder, content in self.contents:
            if isinstance(holder, (dict, set)):
                holder.clear()
                holder.update(content)  # type: ignore[call-overload, arg-type]
            elif isinstance(holder, list):
                holder[:] = content  # type: ignore[call-overload]
            elif isinstance(holder, deque):
                holder.clear()
                holder.extend(content)  # type: ignore[arg-type]
            elif isinstance(holder, np.ndarray):
                holder[...] = content
            else:
                _restore_attributes(holder, content)  # type: ignore[arg-type]


def scan(env: object, skip: Collection[str]) -> Scan:
    """Walk through the attributes of an environment and what they hold.

    Args:
        env: The environment.
        skip: Names of its attributes that are left out and that :meth:`Scan.restore` leaves alone.
    """
    found = Scan()
    own = {name: value for name, value in vars(env).items() if name not in skip}
    found.contents.append((_Root(env, skip), own))
    seen = {id(env)}
    for name, value in own.items():
        _walk(value, (name,), vars(env), name, found, seen)
    # A counter may live on the class. Only those of the task: the framework's own do not change.
    for cls in type(env).__mro__:
        if cls.__module__.partition(".")[0] not in _OPAQUE | sys.stdlib_module_names:
            for name, value in vars(cls).items():
                if isinstance(value, (bool, int, float)) and not name.startswith("__"):
                    found.numbers[cls.__name__, name] = value
                    found.holders[cls.__name__, name] = cls, name
    return found


def storage_of(tensor: torch.Tensor) -> int:
    """Address of the memory that a tensor and its views share; 0 for none."""
    return tensor.untyped_storage().data_ptr()


def path_name(path: Path) -> str:
    """A path as in source code: ``history[0]``, ``buffers['goal']``, ``filter.state``."""
    text = ""
    for key in path:
        text += f"[{key!r}]" if isinstance(key, int) else f".{key}"
    return text.removeprefix(".")


def assign(env: object, path: Path, value: object) -> None:
    """Bind a value to a path; tuples on the way to it are replaced by new ones."""
    _assign(env, path, value)


def _assign(holder: object, path: Path, value: object) -> None:
    key, rest = path[0], path[1:]
    if rest:
        child = _get(holder, key)
        if not isinstance(child, tuple):
            _assign(child, rest, value)
            return
        items = list(child)
        _assign(items, rest, value)
        value = type(child)(*items) if hasattr(child, "_fields") else tuple(items)
    if isinstance(holder, (dict, list, deque)):
        holder[key] = value  # type: ignore[index]
    else:
        object.__setattr__(holder, str(key), value)


def value_at(holder: object, key: str | int) -> object:
    """Value of a container at a key, or of an object under a name; :data:`NOTHING` if there is none."""
    try:
        return _get(holder, key)
    except (LookupError, AttributeError):
        return NOTHING


def fast_slot(holder: object, key: str | int) -> tuple[object, str | int]:
    """Where a value is looked up fastest: in its container, or in the dict of an object's attributes."""
    own = getattr(holder, "__dict__", None)
    is_attribute = not isinstance(holder, (dict, list, tuple, deque)) and isinstance(own, Mapping) and key in own
    return (own if is_attribute else holder), key


class Places:
    """Values at some places, to find out whether each is still there: the very object.

    That is asked in every step, while the device may have nothing to do. So it is a few calls of C rather than a loop.
    """

    def __init__(self, places: Iterable[tuple[Any, Any, object]]):
        """Note the values.

        Args:
            places: Container, key and value of each, of :func:`fast_slot`.
        """
        self._slow: list[tuple[Any, Any, object]] = []
        by_container: dict[int, tuple[Any, list[Any], list[object]]] = {}
        for container, key, value in places:
            if isinstance(container, (dict, list, tuple)):
                _, keys, values = by_container.setdefault(id(container), (container, [], []))
                keys.append(key)
                values.append(value)
            else:
                self._slow.append((container, key, value))
        # With one key a getter returns the value itself rather than a tuple: so the first key comes twice.
        self._groups = [(c, itemgetter(k[0], *k), (v[0], *v)) for c, k, v in by_container.values()]

    def all_in_place(self) -> bool:
        """Whether each place still holds its value."""
        try:
            for container, values_of, values in self._groups:
                if not all(map(operator.is_, values_of(container), values)):
                    return False
        except LookupError:  # it is gone
            return False
        return all(value_at(container, key) is value for container, key, value in self._slow)


def _get(holder: object, key: str | int) -> object:
    if isinstance(holder, (dict, MappingProxyType)):  # the most frequent; a class has a proxy
        return holder[key]
    if isinstance(holder, (list, tuple, deque)):
        return holder[key]  # type: ignore[index]
    return getattr(holder, str(key))


def size_of(container: object) -> int:
    """Number of values that a container of :attr:`Scan.contents` holds."""
    if isinstance(container, _Root):
        return len(vars(container.env))
    if isinstance(container, np.ndarray):
        return container.size
    if isinstance(container, (dict, list, deque, set, frozenset)):
        return len(container)
    own = len(getattr(container, "__dict__", ()))
    return own + sum(hasattr(container, name) for name in _slots(type(container)))


class _Root:
    """The attributes of the environment without those that are left out, as a container."""

    def __init__(self, env: object, skip: Collection[str]):
        self.env, self.skip = env, skip


def _restore_attributes(holder: object, content: dict[str, object]) -> None:
    skip: Collection[str] = ()
    if isinstance(holder, _Root):
        skip, holder = holder.skip, holder.env
    for name in [n for n in _attributes(holder) if n not in content and n not in skip]:
        object.__delattr__(holder, name)
    for name, value in content.items():
        object.__setattr__(holder, name, value)


def _attributes(value: object) -> dict[str, object]:
    """Attributes of an object, those in slots included."""
    slots = _slots(type(value))
    return {n: getattr(value, n) for n in slots if hasattr(value, n)} | getattr(value, "__dict__", {})


_SLOTS: dict[type, list[str]] = {}


def _slots(cls: type) -> list[str]:
    """Names of the slots of a class and of its bases."""
    if cls in _SLOTS:
        return _SLOTS[cls]
    found: list[str] = []
    for base in cls.__mro__:
        slots = vars(base).get("__slots__", ())
        found += [slots] if isinstance(slots, str) else list(slots)
    _SLOTS[cls] = [name for name in found if name not in ("__dict__", "__weakref__")]
    return _SLOTS[cls]


def _walk(value: object, path: Path, holder: object, key: str | int, found: Scan, seen: set[int]) -> None:
    if isinstance(value, torch.Tensor):
        found.tensors[path] = value
        found.holders[path] = holder, key
        return
    if isinstance(value, _NUMBERS):
        found.numbers[path] = value
        found.holders[path] = holder, key
        if value is None:  # where a tensor may be later
            found.links.append((holder, key, value))
        return
    if id(value) in seen:
        found.links.append((holder, key, value))
        return
    if isinstance(value, torch.Generator):
        found.generators.append(value)
    elif isinstance(value, np.ndarray) and value.size <= _SMALL and value.dtype != object:
        seen.add(id(value))
        found.numbers[path] = value.tobytes()
        found.contents.append((value, value.copy()))
    else:
        children = _children(value)
        if children is None:
            return
        seen.add(id(value))
        found.links.append((holder, key, value))
        if not isinstance(value, tuple):
            found.contents.append((value, _copy(value)))
        if isinstance(value, (list, deque, set, frozenset)):
            length: Path = (*path, "len()")
            found.numbers[length] = len(value)
        for name, child in children:
            _walk(child, (*path, name), value, name, found, seen)


def _copy(value: object) -> object:
    if isinstance(value, (dict, list, deque, set)):
        return value.copy()
    return dict(_attributes(value))


def _children(value: object) -> Iterator[tuple[str | int, object]] | None:
    """Parts of a value with their keys; None if it is not looked into."""
    if isinstance(value, dict):
        return ((k, v) for k, v in value.items() if isinstance(k, (str, int)))
    if isinstance(value, (list, tuple, deque)):
        return enumerate(value)
    if isinstance(value, (set, frozenset)):
        return iter(())
    if isinstance(value, type) or (callable(value) and not isinstance(value, (torch.nn.Module, NoiseModel))):
        return None if isinstance(value, type) or _is_foreign(value) else iter(_attributes(value).items())
    if isinstance(value, (torch.nn.Module, NoiseModel)) or is_dataclass(value) or not _is_foreign(value):
        return iter(_attributes(value).items())
    return None


def _is_foreign(value: object) -> bool:
    """Whether the class of an object belongs to a library."""
    package = type(value).__module__.partition(".")[0]
    is_namespace = type(value).__name__ == "SimpleNamespace"
    return package in _OPAQUE or (package in sys.stdlib_module_names and package != "__main__" and not is_namespace)
