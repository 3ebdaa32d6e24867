# SPDX-License-Identifier: Apache-2.0
"""Checkpoint files: written whole or not at all, read without running code; and states of random generators.

Networks and optimiser are as torch writes them, so that other programs can read them. Tensors of the training's state
are compressed (:mod:`.packed_tensors`): with thousands of environments they are most of the file.
"""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import random
import re
import shutil
import struct
import warnings
import zipfile
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np
import torch
from torch.types import Storage

from stripe_newton.input_files import why_no_file
from stripe_newton.rl.errors import CheckpointError, CheckpointWriteError
from stripe_newton.value_types import NonNegativeInt, mismatches, short

from .packed_tensors import pack_tensors, unpack_tensors

__all__ = [
    "CheckpointData",
    "RngState",
    "damage_of",
    "describe_checkpoint_size",
    "from_bytes",
    "get_rng_state",
    "load_checkpoint",
    "save_checkpoint",
    "set_rng_state",
    "tensor_bytes",
    "to_bytes",
]

_STATE = "stripe_newton"
"""Key of the part that is compressed."""
_MUCH = 1e9
"""Size of all checkpoints of a run from which on it is reported [bytes]."""

CheckpointData = dict[str, Any]
"""Contents of a checkpoint: tensors and plain values, nested. The keys are those of rsl_rl's algorithm, and ``iter``,
``infos`` and ``stripe_newton`` (:class:`TrainingState`)."""


class _Needed(TypedDict):
    """Keys that every checkpoint has."""

    iter: NonNegativeInt


class _Contents(_Needed, total=False):
    """The parts of a checkpoint that readers use."""

    actor_state_dict: dict[str, torch.Tensor]
    critic_state_dict: dict[str, torch.Tensor]
    student_state_dict: dict[str, torch.Tensor]
    optimizer_state_dict: dict[str, object]
    stripe_newton: dict[str, object] | None


class RngState(TypedDict, total=False):
    """States of the global random generators, as plain values and tensors."""

    python: tuple[int, torch.Tensor, float | None]
    numpy: tuple[str, torch.Tensor, int, int, float]
    torch: torch.Tensor
    cuda: torch.Tensor


def save_checkpoint(data: CheckpointData, path: str | os.PathLike) -> None:
    """Write ``data`` (tensors and plain values) so that ``path`` is never a half-written file.

    Raises:
        CheckpointWriteError: if the disk is full or cannot be written; ``path`` is then what it was before.
    """
    path = Path(path)
    # Into memory first: a message about a full disk can then say how much room it needs.
    buffer = io.BytesIO()
    torch.save(data | {_STATE: pack_tensors(data[_STATE])} if _STATE in data else data, buffer)
    content = buffer.getbuffer()
    # Another name until all is on the disk. Renaming replaces the old file at once, even if the process is killed.
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
        _sync_folder(path.parent)
    except OSError as error:
        raise CheckpointWriteError(f"{path}: could not be written: {_reason(error, path, len(content))}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def describe_checkpoint_size(path: Path, data: CheckpointData, more: int) -> str:
    """Line about the disk space of a run's checkpoints, if it is much; else empty.

    Args:
        path: A checkpoint that has been written.
        data: Its contents.
        more: Number of checkpoints to come.
    """
    size = path.stat().st_size
    total, free = more * size, shutil.disk_usage(path.parent).free
    if total < min(free, _MUCH):
        return ""
    state = size - tensor_bytes({name: part for name, part in data.items() if name != _STATE})
    each = f"{size / 1e6:.1f} MB each, {state / 1e6:.1f} of them the state of the environments"
    text = f"checkpoints: {each}; {more} more take {total / 1e9:.1f} GB (agent.save_interval sets how many)"
    return text if total < free else f"warning: {text}, but {free / 1e9:.1f} GB are free in {path.parent}"


def tensor_bytes(value: object) -> int:
    """Size of all tensors in nested dicts and lists [bytes]."""
    if isinstance(value, torch.Tensor):
        return value.numel() * value.element_size()
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ()
    return sum(map(tensor_bytes, parts))


def _reason(error: OSError, path: Path, needed: int) -> str:
    """The error of the system, and how much room there is."""
    # The folder itself may not exist yet.
    folder = next((parent for parent in path.absolute().parents if parent.is_dir()), Path("/"))
    free = shutil.disk_usage(folder).free
    return f"{error.strerror or error} (it needs {needed / 1e6:.2f} MB, {free / 1e6:.2f} MB are free in {folder})"


def _sync_folder(folder: Path) -> None:
    """Flush the name of a new file to the disk, so that it outlives a loss of power, where the file system can."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def damage_of(path: str | os.PathLike) -> str | None:
    """Damage of a file that :func:`save_checkpoint` wrote, found by its checksums; None if it is whole."""
    if problem := why_no_file(path):
        return problem
    try:
        with zipfile.ZipFile(path) as archive:
            return _damage_of_zip(archive, os.path.getsize(path))
    except zipfile.BadZipFile:
        with open(path, "rb") as file:
            magic = file.read(2)
        return "is damaged or cut short" if magic in (b"PK", b"") else "was not written by torch.save"
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"
    except (ValueError, RuntimeError, struct.error) as error:  # what zipfile raises for headers that make no sense
        return f"is damaged ({_first_line(error)})"


def _damage_of_zip(archive: zipfile.ZipFile, size: int) -> str | None:
    members = archive.infolist()
    # Before anything is unpacked: torch.save neither packs nor encrypts, so what it wrote is no larger than the file.
    if any(member.flag_bits & 1 for member in members):
        return "is an encrypted archive, which torch.save does not write"
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        return "is a packed archive, which torch.save does not write"
    if sum(member.file_size for member in members) > size:
        return "is damaged: its parts are larger than the file"
    bad = archive.testzip()
    return None if bad is None else f"is damaged: the checksum of '{bad}' is wrong"


def load_checkpoint(path: str | os.PathLike, device: str | torch.device = "cpu") -> CheckpointData:
    """Read a checkpoint without running code from it (``weights_only=True``).

    Tensors that were saved from a GPU go to ``device``; those from the CPU, such as random states, stay there.

    Raises:
        CheckpointError: if the file is missing, damaged, or not a checkpoint of rsl_rl 5.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise CheckpointError(f"a checkpoint is given by its path, not by {short(path)}")
    path = Path(path)
    damage = damage_of(path)
    if damage is not None:
        raise CheckpointError(f"{path}: {damage}; a checkpoint is the file model_K.pt of a run")
    try:
        data = _load(path, device)
    except pickle.UnpicklingError as error:
        # The line that names the refused class stands in the middle of torch's long explanation.
        named = re.search(r"GLOBAL (\S+)", str(error))
        reason = named[1] if named else _first_line(error)
        text = "contains more than tensors and plain values, so it is not read"
        raise CheckpointError(f"{path}: {text} ({reason})") from None
    except Exception as error:  # whatever a pickle of somebody else's makes torch run into
        raise CheckpointError(f"{path}: was not written by torch.save ({_first_line(error)})") from None
    # rsl_rl before version 5 had other keys, and other programs have none of these.
    if not isinstance(data, dict) or not {"actor_state_dict", "student_state_dict"} & set(data):
        found = f"keys {sorted(map(str, data))[:6]}" if isinstance(data, dict) else type(data).__name__
        raise CheckpointError(
            f"{path}: is not a checkpoint of rsl_rl 5, expected a dict with 'actor_state_dict', found {found}"
        )
    if wrong := list(mismatches(data, _Contents)):
        raise CheckpointError(f"{path}: has wrong contents: {'; '.join(wrong[:3])}")
    try:
        return data | {_STATE: unpack_tensors(data[_STATE], device, path.stat().st_size)} if _STATE in data else data
    except ValueError as error:
        raise CheckpointError(f"{path}: '{_STATE}': {error}") from None


def to_bytes(data: object) -> torch.Tensor:
    """Serialise a rank's part of a checkpoint as a tensor of bytes, uint8 ``(bytes,)``, with large tensors packed."""
    buffer = io.BytesIO()
    torch.save(pack_tensors(data), buffer)
    return torch.frombuffer(bytearray(buffer.getbuffer()), dtype=torch.uint8)


def from_bytes(content: torch.Tensor, device: str | torch.device = "cpu") -> CheckpointData:
    """Read what :func:`to_bytes` made; tensors from a GPU go to ``device``.

    Raises:
        ValueError: if it is damaged.
    """
    file = io.BytesIO(content.cpu().numpy().tobytes())
    try:
        with zipfile.ZipFile(file) as archive:
            damage = _damage_of_zip(archive, content.numel())
    except zipfile.BadZipFile:
        damage = "is damaged or cut short"
    if damage:
        raise ValueError(f"the state of a rank {damage}")
    file.seek(0)
    return cast(CheckpointData, unpack_tensors(_load(file, device), device, content.numel()))


def _load(source: Path | io.BytesIO, device: str | torch.device) -> CheckpointData:
    def place(storage: Storage, location: str) -> Storage:
        # Not all to the device, as a plain `map_location` does: states of generators must stay on the CPU.
        if location == "cpu" or torch.device(device).type == "cpu":
            return storage
        return torch.serialization.default_restore_location(storage, str(device))

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'torch.load' received a zip file that looks like a TorchScript")
        return torch.load(source, weights_only=True, map_location=place)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]


def get_rng_state(device: str | torch.device) -> RngState:
    """The states of Python's, NumPy's and torch's global generators, that of ``device`` included."""
    # As tensors, since `weights_only=True` refuses NumPy's arrays and scalars.
    version, numbers, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002 (users draw from it)
    state: RngState = {
        "python": (version, torch.tensor(numbers, dtype=torch.int64), gauss),
        "numpy": (
            str(name),
            torch.from_numpy(np.asarray(keys).astype(np.int64)),
            int(position),
            int(has_gauss),
            float(cached),
        ),
        "torch": torch.get_rng_state(),
    }
    if torch.device(device).type == "cuda":
        state["cuda"] = torch.cuda.get_rng_state(device)
    return state


def set_rng_state(state: RngState, device: str | torch.device) -> None:
    """Put back what :func:`get_rng_state` returned."""
    version, words, gauss = state["python"]
    random.setstate((version, tuple(words.tolist()), gauss))
    name, keys, position, has_gauss, cached = state["numpy"]
    numbers = keys.numpy().astype(np.uint32)
    np.random.set_state((name, numbers, position, has_gauss, cached))  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    if "cuda" in state and torch.device(device).type == "cuda":
        torch.cuda.set_rng_state(state["cuda"], device)
