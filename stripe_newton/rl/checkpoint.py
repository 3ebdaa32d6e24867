# SPDX-License-Identifier: Apache-2.0
"""Checkpoint files: written whole or not at all, read without running code, and the random state that goes in."""

from __future__ import annotations

import os
import pickle
import random
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .errors import CheckpointError

__all__ = ["get_rng_state", "load_checkpoint", "save_checkpoint", "set_rng_state"]


def save_checkpoint(data: dict[str, Any], path: str | os.PathLike) -> None:
    """Write ``data`` (tensors and plain values) so that ``path`` is never a half-written file."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    try:
        with open(part, "wb") as file:
            torch.save(data, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def load_checkpoint(path: str | os.PathLike, device: str | torch.device = "cpu") -> dict[str, Any]:
    """Read a checkpoint without running code from it (``weights_only=True``).

    What was saved from a GPU goes to ``device``; what was saved from the CPU, such as random states, stays there.

    Raises:
        CheckpointError: if the file is missing, damaged, or not a checkpoint of rsl_rl 5.
    """

    def place(storage: Any, location: str) -> Any:
        if location == "cpu" or torch.device(device).type == "cpu":
            return storage
        return torch.serialization.default_restore_location(storage, str(device))

    try:
        with open(path, "rb") as file:
            magic = file.read(2)
        if not zipfile.is_zipfile(path):
            reason = "is damaged or cut short" if magic == b"PK" else "is no file that torch.save wrote"
            raise CheckpointError(f"{path}: {reason}")
        data = torch.load(path, weights_only=True, map_location=place)
    except FileNotFoundError:
        raise CheckpointError(f"{path}: does not exist") from None
    except pickle.UnpicklingError as error:
        reason = next((line.strip() for line in str(error).splitlines() if "GLOBAL" in line), _first_line(error))
        raise CheckpointError(f"{path}: holds more than tensors and plain values, it is not read ({reason})") from None
    except (RuntimeError, EOFError, OSError) as error:
        raise CheckpointError(f"{path}: cannot be read, is it damaged? ({_first_line(error)})") from None
    if not isinstance(data, dict) or "actor_state_dict" not in data:
        found = f"keys {sorted(map(str, data))[:6]}" if isinstance(data, dict) else type(data).__name__
        raise CheckpointError(
            f"{path}: is no checkpoint of rsl_rl 5, expected a dict with 'actor_state_dict', found {found}"
        )
    return data


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]


def get_rng_state(device: str | torch.device) -> dict[str, Any]:
    """The states of Python's, NumPy's and torch's global generators, the one of ``device`` included."""
    version, numbers, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002 (users draw from it)
    state: dict[str, Any] = {
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


def set_rng_state(state: dict[str, Any], device: str | torch.device) -> None:
    """Put back what :func:`get_rng_state` returned."""
    version, numbers, gauss = state["python"]
    random.setstate((version, tuple(numbers.tolist()), gauss))
    name, keys, *rest = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), *rest))  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    if "cuda" in state and torch.device(device).type == "cuda":
        torch.cuda.set_rng_state(state["cuda"], device)
