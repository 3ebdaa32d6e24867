# SPDX-License-Identifier: Apache-2.0
"""Readers of motion files: CSV as Unitree publishes retargeted motions, and NPZ as BeyondMimic and mjlab write them."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from glob import glob
from pathlib import Path
from typing import Literal

import numpy as np

from stripe_newton.input_files import why_no_file

from .motion import Motion, MotionError

__all__ = ["QuaternionOrder", "find_motions", "read_motion"]

QuaternionOrder = Literal["xyzw", "wxyz"]
"""Order of the numbers of a quaternion."""

SUFFIXES = (".csv", ".npz")
_ROOT = 7
"""Columns of a CSV file before the joints: position and quaternion of the root."""
_CSV_FPS = 30.0
"""Rate of the motions that Unitree publishes [1/s]."""
_KEYS = ("fps", "joint_pos", "body_pos_w", "body_quat_w")


def find_motions(files: str | Sequence[str]) -> list[Path]:
    """Motion files by paths, folders and patterns, sorted within each.

    Raises:
        MotionError: for one that names no CSV or NPZ file.
    """
    found: list[Path] = []
    for name in [files] if isinstance(files, str) else files:
        path = Path(name).expanduser()
        if path.is_dir():
            here = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES)
        elif path.is_file():
            here = [path]
        else:
            here = sorted(map(Path, glob(str(path), recursive=True)))
        if not here:
            what = "is a folder without" if path.is_dir() else "is neither a file nor a folder nor a pattern of"
            raise MotionError(f"{name}: {what} motions; they are .csv or .npz")
        found += here
    return found


def read_motion(
    path: str | Path,
    fps: float | None = None,
    joint_names: Sequence[str] | None = None,
    quaternions: QuaternionOrder | None = None,
) -> Motion:
    """Read a motion.

    A CSV file has a row for each frame: position of the root [m], its quaternion, and the joint positions [rad]; a
    first row of names is allowed. An NPZ file has ``fps``, ``joint_pos``, and ``body_pos_w`` and ``body_quat_w`` of all
    bodies, of which the first is the root; velocities in it are not read, as they follow from the poses.

    Args:
        path: The file.
        fps: Frames a second. Default: what the file says (NPZ), or its name (``..._60hz.csv``), else 30.
        joint_names: Names of the joints in the file's order. Default: the first row of the file if it has names, else
            None, which stands for the robot's own.
        quaternions: Order of the quaternions. Default: (x, y, z, w) in CSV, (w, x, y, z) in NPZ, as they are published.

    Raises:
        MotionError: the file is no motion; the message says what is wrong, and where.
    """
    path = Path(path)
    if problem := why_no_file(path):
        raise MotionError(f"{path}: {problem}")
    if path.suffix.lower() not in SUFFIXES:
        raise MotionError(f"{path}: must end in .csv or .npz")
    names = tuple(joint_names) if joint_names is not None else None
    read = _read_csv if path.suffix.lower() == ".csv" else _read_npz
    motion = read(path, fps, names, quaternions)
    _check(motion)
    return motion


def _read_csv(
    path: Path, fps: float | None, names: tuple[str, ...] | None, quaternions: QuaternionOrder | None
) -> Motion:
    try:
        lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    except UnicodeDecodeError:
        raise MotionError(f"{path}: is not a text file") from None
    if lines and not _is_number(lines[0].split(",")[0]):
        header = [word.strip() for word in lines.pop(0).split(",")]
        names = names or tuple(header[_ROOT:])
    rows = [line.split(",") for line in lines]
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise MotionError(f"{path}: row {number} has {len(row)} numbers, row 1 has {len(rows[0])}")
        wrong = next((word for word in row if not _is_number(word)), None)
        if wrong is not None:
            raise MotionError(f"{path}: row {number} has {wrong.strip()!r}, which is no number")
    if not rows or len(rows[0]) <= _ROOT:
        count = len(rows[0]) if rows else 0
        raise MotionError(f"{path}: a row has {count} numbers, must have {_ROOT} of the root and those of the joints")
    data = np.array(rows, dtype=np.float64)
    rate = re.search(r"(\d+(?:\.\d+)?)\s*hz", path.stem, re.IGNORECASE)
    own = float(rate.group(1)) if rate else _CSV_FPS
    return Motion(
        name=str(path),
        fps=own if fps is None else fps,
        root_pos=data[:, :3],
        root_quat=_as_xyzw(data[:, 3:_ROOT], quaternions or "xyzw"),
        joint_pos=data[:, _ROOT:],
        joint_names=names,
    )


def _read_npz(
    path: Path, fps: float | None, names: tuple[str, ...] | None, quaternions: QuaternionOrder | None
) -> Motion:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: np.asarray(file[key], dtype=np.float64) for key in _KEYS if key in file.files}
            there = file.files
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise MotionError(f"{path}: cannot be read as NPZ: {error}") from None
    missing = [key for key in _KEYS if key not in arrays and not (key == "fps" and fps is not None)]
    if missing:
        raise MotionError(f"{path}: has no {', '.join(missing)}; it has {', '.join(there) or 'nothing'}")
    joints, pos, quat = arrays["joint_pos"], arrays["body_pos_w"], arrays["body_quat_w"]
    if joints.ndim != 2 or pos.ndim != 3 or quat.ndim != 3 or (pos.shape[2], quat.shape[2]) != (3, 4):
        shapes = f"joint_pos {joints.shape}, body_pos_w {pos.shape}, body_quat_w {quat.shape}"
        raise MotionError(f"{path}: has {shapes}; must be (frames, joints), (frames, bodies, 3), (frames, bodies, 4)")
    if not len(joints) == len(pos) == len(quat):
        raise MotionError(f"{path}: joint_pos has {len(joints)} frames, body_pos_w {len(pos)}, body_quat_w {len(quat)}")
    return Motion(
        name=str(path),
        fps=float(arrays["fps"].reshape(-1)[0]) if fps is None else fps,
        root_pos=pos[:, 0],
        root_quat=_as_xyzw(quat[:, 0], quaternions or "wxyz"),
        joint_pos=joints,
        joint_names=names,
        body_pos=pos,
    )


def _as_xyzw(quaternions: np.ndarray, order: QuaternionOrder) -> np.ndarray:
    return quaternions if order == "xyzw" else np.roll(quaternions, -1, axis=1)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _check(motion: Motion) -> None:
    """Raise if numbers of a motion cannot be, and bring its quaternions to unit length."""
    if motion.num_frames < 2:
        raise MotionError(f"{motion.name}: has {motion.num_frames} frames, must have two or more")
    if not 0.0 < motion.fps <= 10000.0:
        raise MotionError(f"{motion.name}: has {motion.fps} frames a second")
    for what in ("root_pos", "root_quat", "joint_pos"):
        bad = ~np.isfinite(getattr(motion, what)).all(axis=1)
        if bad.any():
            raise MotionError(f"{motion.name}: {what} of frame {int(np.argmax(bad)) + 1} is not finite")
    norms = np.linalg.norm(motion.root_quat, axis=1)
    wrong = np.abs(norms - 1.0) > 0.01
    if wrong.any():
        frame = int(np.argmax(wrong))
        raise MotionError(f"{motion.name}: quaternion of frame {frame + 1} has length {norms[frame]:.4g}, must be 1")
    motion.root_quat[:] = motion.root_quat / norms[:, None]
