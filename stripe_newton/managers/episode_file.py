# SPDX-License-Identifier: Apache-2.0
"""Episode file: recorded episodes in HDF5, laid out as Isaac Lab and robomimic read them.

::

    /                          format_version: 1, absent where quaternions are wxyz (Isaac Lab)
    data/                      total: samples; env_args: JSON; quat_convention: "xyzw" or "wxyz"
        demo_0/                num_samples; seed, success and env_index where known
            actions, processed_actions            (num_samples, n)
            obs/...                               (num_samples, ...), one dataset a group or term
            states/articulation/NAME/root_pose    (num_samples, 7), and root_velocity, joint_position, joint_velocity
            initial_state/...                     the same with one row

Poses are (x, y, z, quaternion), positions relative to the environment's origin; SI units.
"""

from __future__ import annotations

import importlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from stripe_newton.input_files import why_no_file
from stripe_newton.value_types import short

if TYPE_CHECKING:
    import h5py

__all__ = ["Episode", "EpisodeFile", "import_h5py"]

Episode = dict[str, Any]
"""Nested dicts of tensors whose first dimension is time."""

_FORMAT_VERSION = 1


def import_h5py() -> ModuleType:
    """The ``h5py`` package.

    Raises:
        ImportError: if it is not installed.
    """
    try:
        return importlib.import_module("h5py")
    except ImportError as error:
        raise ImportError("recorded episodes need h5py: pip install stripe-newton[record]") from error


class EpisodeFile:
    """Episodes by name; made by :meth:`create` to be written or by :meth:`open` to be read.

    Attributes:
        path: The file.
        quaternion_order: Order of quaternions in it, ``"xyzw"`` or ``"wxyz"``.
        env_args: The environment: ``env_name``, ``type`` and more.
    """

    def __init__(self, path: Path, file: h5py.File, compression: bool = True):
        self.path, self._file, self._compression = path, file, compression
        self._data = file["data"]
        try:
            version = int(self._number(file, "format_version", 0))
            self.quaternion_order = self._text("quat_convention", "xyzw" if version >= 1 else "wxyz")
            if self.quaternion_order not in ("xyzw", "wxyz"):
                raise self._wrong("quat_convention", self.quaternion_order, "'xyzw' or 'wxyz'")
            self.env_args = self._env_args()
        except ValueError:
            file.close()
            raise
        self._next = 1 + max((_number(name) for name in self.names), default=-1)

    def _env_args(self) -> dict[str, object]:
        text = self._text("env_args", "{}")
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise self._wrong("env_args", text, "a JSON object")
        return found

    def _wrong(self, name: str, value: object, must: str) -> ValueError:
        return ValueError(f"{self.path}: the attribute '{name}' is {short(value)}, must be {must}")

    def _text(self, name: str, default: str) -> str:
        value = _attributes(self._data).get(name, default)
        if not isinstance(value, str):
            raise self._wrong(name, value, "text")
        return value

    def _number(self, holder: h5py.Group, name: str, default: float | None = None) -> float:
        """A finite number that is an attribute.

        Raises:
            ValueError: if it is missing and has no default, or is something else.
        """
        value = _attributes(holder).get(name, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
            raise self._wrong(name, "missing" if value is None else value, "a number of at least 0")
        return value

    @classmethod
    def create(
        cls,
        path: str | os.PathLike,
        env_args: Mapping[str, object],
        mode: str = "new",
        quaternion_order: str = "xyzw",
        compression: bool = True,
    ) -> EpisodeFile:
        """A file to write to.

        Args:
            path: Where; folders above it are made.
            env_args: Written as JSON; robomimic needs ``env_name``, ``type`` and ``env_kwargs``.
            mode: ``"new"``, ``"append"`` or ``"overwrite"``; the last two make the file if there is none.
            quaternion_order: ``"xyzw"`` or ``"wxyz"``.
            compression: Whether to compress datasets.

        Raises:
            FileExistsError: if the file exists and ``mode`` is ``"new"``.
            ValueError: if it exists, and what it holds is something else than what would be appended.
        """
        package, path = import_h5py(), Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        if mode == "new" and path.exists():
            raise FileExistsError(f"{path}: exists; set dataset_file_mode to 'append' or 'overwrite', or another name")
        if mode == "append" and path.exists():
            found = cls(path, _opened(package, path, "r+"), compression)
            found._check_fit(env_args, quaternion_order)
            return found
        file = package.File(path, "w" if mode == "overwrite" else "x")
        if quaternion_order == "xyzw":
            file.attrs["format_version"] = _FORMAT_VERSION
        attributes = file.create_group("data").attrs
        attributes["total"] = 0
        attributes["env_args"] = json.dumps(dict(env_args))
        attributes["quat_convention"] = quaternion_order
        file.flush()
        return cls(path, file, compression)

    @classmethod
    def open(cls, path: str | os.PathLike) -> EpisodeFile:
        """A file to read, also one that Isaac Lab wrote.

        Raises:
            FileNotFoundError: if there is none.
            ValueError: if it holds no episodes.
        """
        return cls(Path(path), _opened(import_h5py(), Path(path), "r"))

    def _check_fit(self, env_args: Mapping[str, object], quaternion_order: str) -> None:
        here, other = self.env_args.get("env_name"), env_args.get("env_name")
        problem = ""
        if self.quaternion_order != quaternion_order:
            problem = f"its quaternions are {self.quaternion_order}, not {quaternion_order}: set quaternion_order"
        elif here and other and here != other:
            problem = f"its episodes are of '{here}', not '{other}': set dataset_filename"
        if problem:
            self.close()
            raise ValueError(f"{self.path}: cannot be appended to, {problem}")
        self._data.attrs["total"] = int(sum(self.attributes(n)["num_samples"] for n in self.names))

    # -- reading

    @property
    def names(self) -> list[str]:
        """Names of the episodes, in the order they were written."""
        return sorted(self._data, key=_number)

    @property
    def total(self) -> int:
        """Samples of all episodes."""
        if "total" in self._data.attrs:
            return int(self._number(self._data, "total"))
        return int(sum(self._number(self._episode(name), "num_samples") for name in self.names))

    def __len__(self) -> int:
        return len(self._data)

    def __iter__(self) -> Iterator[Episode]:
        return (self.read(name) for name in self.names)

    def attributes(self, name: str) -> dict[str, Any]:
        """``num_samples`` of an episode, and ``seed``, ``success``, ``env_index`` where the file has them.

        Raises:
            KeyError: if there is no such episode.
            ValueError: if it does not say how many samples it has.
        """
        episode = self._episode(name)
        return _attributes(episode) | {"num_samples": int(self._number(episode, "num_samples"))}

    def read(self, name: str, device: str = "cpu") -> Episode:
        """An episode as nested dicts of tensors; quaternions in every ``root_pose`` are xyzw, whatever the file's are.

        Raises:
            KeyError: if there is no such episode.
            ValueError: if something else than numbers is in it, or a link to another file.
        """
        return self._read(self._episode(name), device)

    def _episode(self, name: str) -> h5py.Group:
        if name not in self._data:
            raise KeyError(f"{self.path}: no episode '{name}'; it has {len(self)}: {', '.join(self.names[:5])}, ...")
        found = self._entry(self._data, name)
        if not hasattr(found, "keys"):
            raise ValueError(f"{self.path}: {found.name} is no group, so it is no episode")
        return found

    def _entry(self, group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
        """An entry of a group that is in this file: a link to another file could lead to any file of the user's."""
        link = group.get(name, getlink=True)
        if not isinstance(link, import_h5py().HardLink):
            raise ValueError(f"{self.path}: {group.name}/{name} is a link, of which recorded episodes have none")
        try:
            return group[name]
        except (KeyError, OSError, RuntimeError) as error:
            raise ValueError(f"{self.path}: {group.name}/{name} cannot be read: {error}") from None

    def _read(self, group: h5py.Group, device: str) -> Episode:
        out: Episode = {}
        for key in group:
            item = self._entry(group, key)
            if hasattr(item, "keys"):
                out[key] = self._read(item, device)
            else:
                value = self._values(item)
                if key == "root_pose" and self.quaternion_order == "wxyz":
                    value = value[..., [0, 1, 2, 4, 5, 6, 3]]
                out[key] = torch.as_tensor(value, device=device)
        return out

    def _values(self, item: h5py.Dataset) -> np.ndarray:
        """All numbers of a dataset.

        Raises:
            ValueError: if it has something else, or is damaged.
        """
        if item.shape is None or item.dtype.kind not in "biuf":
            raise ValueError(f"{self.path}: {item.name} has {item.dtype}, must have numbers")
        if item.external or item.is_virtual:  # which could be any file of the user's
            raise ValueError(f"{self.path}: {item.name} has its numbers in another file, as no recorded episode has")
        try:
            return np.asarray(item[()])
        except (OSError, RuntimeError) as error:
            raise ValueError(f"{self.path}: {item.name} cannot be read: {error}") from None

    # -- writing

    def write(self, data: Mapping[str, object], num_samples: int, **attributes: object) -> str:
        """Add an episode and flush it; it becomes part of the file once it is complete.

        Args:
            data: Nested dicts of arrays, first dimension time; quaternions xyzw.
            num_samples: Number of steps.
            attributes: ``seed``, ``success``, ``env_index``; those that are None are left out.

        Returns:
            Its name.
        """
        package = import_h5py()
        episode = package.Group(package.h5g.create(self._file.id, None))  # belongs to no group until it is linked below
        episode.attrs["num_samples"] = num_samples
        for key, value in attributes.items():
            if value is not None:
                episode.attrs[key] = value
        self._write(episode, data)
        self._file.flush()
        name = f"demo_{self._next}"
        self._data[name] = episode
        self._data.attrs.modify("total", self.total + num_samples)
        self._file.flush()
        self._next += 1
        return name

    def _write(self, group: h5py.Group, data: Mapping[str, object]) -> None:
        for key, value in data.items():
            if isinstance(value, Mapping):
                self._write(group.create_group(key), value)
                continue
            array = np.asarray(value)
            if key == "root_pose" and self.quaternion_order == "wxyz":
                array = array[..., [0, 1, 2, 6, 3, 4, 5]]
            group.create_dataset(key, data=array, compression="gzip" if self._compression and array.size else None)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> EpisodeFile:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _number(name: str) -> int:
    end = name.rpartition("_")[2]
    return int(end) if end.isdecimal() else -1


def _attributes(holder: h5py.Group) -> dict[str, Any]:
    """Attributes by name: plain values where they are single, arrays and h5py's own objects otherwise."""
    found = {}
    for name, value in holder.attrs.items():
        if getattr(value, "size", 0) == 1 and hasattr(value, "item"):
            value = value.item()
        found[name] = value.decode(errors="replace") if isinstance(value, bytes) else value
    return found


def _opened(package: ModuleType, path: Path, mode: str) -> h5py.File:
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    if problem := why_no_file(path):
        raise ValueError(f"{path}: {problem}")
    try:
        file = package.File(path, mode)
    except OSError as error:
        raise ValueError(f"{path}: cannot be opened as an HDF5 file: {error}") from error
    # Of this file itself: a link could lead to any file of the user's.
    own = isinstance(file.get("data", getlink=True), package.HardLink)
    if not own or not isinstance(file.get("data"), package.Group):
        file.close()
        raise ValueError(f"{path}: has no group 'data', it holds no recorded episodes")
    return file
