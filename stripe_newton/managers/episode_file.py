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
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

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
        version = file.attrs.get("format_version", 0)
        self.quaternion_order = str(self._data.attrs.get("quat_convention", "xyzw" if version >= 1 else "wxyz"))
        self.env_args: dict[str, object] = json.loads(self._data.attrs.get("env_args", "{}"))
        self._next = 1 + max((_number(name) for name in self.names), default=-1)

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
        self._data.attrs.modify("total", sum(self.attributes(n)["num_samples"] for n in self.names))

    # -- reading

    @property
    def names(self) -> list[str]:
        """Names of the episodes, in the order they were written."""
        return sorted(self._data, key=_number)

    @property
    def total(self) -> int:
        """Samples of all episodes."""
        return int(self._data.attrs["total"])

    def __len__(self) -> int:
        return len(self._data)

    def __iter__(self) -> Iterator[Episode]:
        return (self.read(name) for name in self.names)

    def attributes(self, name: str) -> dict[str, Any]:
        """``num_samples`` of an episode, and ``seed``, ``success``, ``env_index`` where the file has them.

        Raises:
            KeyError: if there is no such episode.
        """
        return {k: v.item() if hasattr(v, "item") else v for k, v in self._episode(name).attrs.items()}

    def read(self, name: str, device: str = "cpu") -> Episode:
        """An episode as nested dicts of tensors; quaternions in every ``root_pose`` are xyzw, whatever the file's are.

        Raises:
            KeyError: if there is no such episode.
        """
        return self._read(self._episode(name), device)

    def _episode(self, name: str) -> h5py.Group:
        if name not in self._data:
            raise KeyError(f"{self.path}: no episode '{name}'; it has {len(self)}: {', '.join(self.names[:5])}, ...")
        return self._data[name]

    def _read(self, group: h5py.Group, device: str) -> Episode:
        out: Episode = {}
        for key, item in group.items():
            if hasattr(item, "keys"):
                out[key] = self._read(item, device)
            else:
                value = item[()]
                if key == "root_pose" and self.quaternion_order == "wxyz":
                    value = value[..., [0, 1, 2, 4, 5, 6, 3]]
                out[key] = torch.as_tensor(value, device=device)
        return out

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


def _opened(package: ModuleType, path: Path, mode: str) -> h5py.File:
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        file = package.File(path, mode)
    except OSError as error:
        raise ValueError(f"{path}: cannot be opened as an HDF5 file: {error}") from error
    if "data" not in file:
        file.close()
        raise ValueError(f"{path}: has no group 'data', it holds no recorded episodes")
    return file
