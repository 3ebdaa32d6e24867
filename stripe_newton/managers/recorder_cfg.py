# SPDX-License-Identifier: Apache-2.0
"""Config of what is recorded, and where it is written."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stripe_newton.configclass import MISSING, configclass

__all__ = ["DatasetExportMode", "RecorderManagerBaseCfg", "RecorderTermCfg"]

_CHOICES = {"dataset_file_mode": ("new", "append", "overwrite"), "quaternion_order": ("xyzw", "wxyz")}


class DatasetExportMode(enum.IntEnum):
    """Which episodes are written."""

    EXPORT_NONE = 0
    """None; they can still be read by ``get_episode``."""
    EXPORT_ALL = 1
    """All, into one file."""
    EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES = 2
    """All; those that did not succeed into ``FILENAME_failed.hdf5``."""
    EXPORT_SUCCEEDED_ONLY = 3
    """Those that succeeded."""
    EXPORT_FAILED_ONLY = 4
    """Those that did not succeed."""


@configclass
class RecorderTermCfg:
    """One thing to record."""

    class_type: type = MISSING
    """Subclass of :class:`RecorderTerm`, made with this config and the environment."""


@configclass
class RecorderManagerBaseCfg:
    """Where episodes are written; the fields that a subclass adds are the terms."""

    dataset_export_dir_path: str = "logs/recordings"
    """Folder of the file; it is made."""
    dataset_filename: str = "dataset"
    """Name of the file, with or without ``.hdf5``."""
    dataset_export_mode: DatasetExportMode = DatasetExportMode.EXPORT_ALL
    """Which episodes are written."""
    dataset_file_mode: str = "new"
    """What to do if the file exists: ``"new"`` refuses, ``"append"`` goes on after its last episode, ``"overwrite"``
    begins it anew."""
    dataset_compression: bool = True
    """Whether datasets are compressed with gzip."""
    quaternion_order: str = "xyzw"
    """Order of the quaternions in every ``root_pose``: ``"xyzw"`` as in Isaac Lab 3, ``"wxyz"`` as in Isaac Lab 2. The
    file says which, by ``data.attrs["quat_convention"]`` and as Isaac Lab does by the file's ``format_version``. Other
    quaternions, such as those in observations, are written as they are."""
    export_in_record_pre_reset: bool = True
    """Whether an episode is written when it ends; if not, it is dropped unless ``export_episodes`` is called before."""

    def paths(self) -> list[Path]:
        """The files that are written, that of the failed episodes last."""
        mode, kinds = self.dataset_export_mode, DatasetExportMode
        if mode == kinds.EXPORT_NONE:
            return []
        stem = Path(self.dataset_export_dir_path) / self.dataset_filename.removesuffix(".hdf5")
        both = mode == kinds.EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES
        return [stem.with_name(f"{stem.name}{end}.hdf5") for end in (["", "_failed"] if both else [""])]

    def problems(self) -> Iterator[tuple[str, str]]:
        for name, known in _CHOICES.items():
            value = getattr(self, name)
            if value not in known:
                yield name, f"is {value!r}, must be one of {', '.join(known)}"
        mode: Any = self.dataset_export_mode
        if not isinstance(mode, DatasetExportMode):
            names = ", ".join(m.name for m in DatasetExportMode)
            yield "dataset_export_mode", f"is {mode!r}, must be one of DatasetExportMode: {names}"
        if not self.dataset_filename.removesuffix(".hdf5") or Path(self.dataset_filename).name != self.dataset_filename:
            yield "dataset_filename", f"is '{self.dataset_filename}', must be a name; set dataset_export_dir_path too"
