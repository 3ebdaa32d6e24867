# SPDX-License-Identifier: Apache-2.0
"""Files by name: folders of NVIDIA's asset server as names, and the functions that read files."""

from __future__ import annotations

import io
import os
from pathlib import Path

import torch

__all__ = [
    "ASSETS_VARIABLE",
    "ISAACLAB_NUCLEUS_DIR",
    "ISAAC_NUCLEUS_DIR",
    "NUCLEUS_ASSET_ROOT_DIR",
    "NVIDIA_NUCLEUS_DIR",
    "check_file_path",
    "is_on_server",
    "load_torchscript_model",
    "local_copy",
    "read_file",
    "retrieve_file_path",
]

NUCLEUS_ASSET_ROOT_DIR = "nucleus:/"
"""Root of NVIDIA's asset server. No file is below it: a path is a name, which is resolved when it is needed."""
ASSETS_VARIABLE = "NUCLEUS_ASSET_ROOT"
"""Environment variable: a folder with files of NVIDIA's server at their paths there, ``Isaac/Robots/...``."""
NVIDIA_NUCLEUS_DIR = f"{NUCLEUS_ASSET_ROOT_DIR}/NVIDIA"
"""Folder of materials and skies."""
ISAAC_NUCLEUS_DIR = f"{NUCLEUS_ASSET_ROOT_DIR}/Isaac"
"""Folder of Isaac Sim's robots and props."""
ISAACLAB_NUCLEUS_DIR = f"{ISAAC_NUCLEUS_DIR}/IsaacLab"
"""Folder of Isaac Lab's robots."""


def is_on_server(path: str) -> bool:
    """Whether a path lies on NVIDIA's asset server."""
    return path.startswith(NUCLEUS_ASSET_ROOT_DIR)


def local_copy(path: str) -> str | None:
    """The file for a path on NVIDIA's server in the folder that :data:`ASSETS_VARIABLE` names, if it is there."""
    folder = os.environ.get(ASSETS_VARIABLE)
    if folder is None or not is_on_server(path):
        return None
    file = Path(folder).expanduser() / path.removeprefix(NUCLEUS_ASSET_ROOT_DIR).lstrip("/")
    return str(file) if file.is_file() else None


def check_file_path(path: str) -> int:
    """1 if a file is on this machine, 0 if not; nothing is on a server (2 in Isaac Lab)."""
    return int(local_copy(path) is not None or (not is_on_server(path) and Path(path).is_file()))


def retrieve_file_path(path: str, download_dir: str | None = None, force_download: bool = True) -> str:
    """The absolute path of a file on this machine.

    Raises:
        FileNotFoundError: there is no such file, or only NVIDIA's server has it.
    """
    if (copy := local_copy(path)) is not None:
        return copy
    if is_on_server(path):
        raise FileNotFoundError(
            f"'{path.removeprefix(NUCLEUS_ASSET_ROOT_DIR + '/')}' is on NVIDIA's asset server, which the Isaac Lab "
            f"dialect does not read; give the path of a file of your own in its place, or put it at this path below a "
            f"folder and set {ASSETS_VARIABLE} to that folder"
        )
    if not Path(path).is_file():
        raise FileNotFoundError(f"no file '{path}'")
    return str(Path(path).resolve())


def read_file(path: str) -> io.BytesIO:
    """The bytes of a file.

    Raises:
        FileNotFoundError: as :func:`retrieve_file_path`.
    """
    return io.BytesIO(Path(retrieve_file_path(path)).read_bytes())


def load_torchscript_model(model_path: str, device: str = "cpu") -> torch.jit.ScriptModule:
    """A TorchScript model, to be evaluated.

    Raises:
        FileNotFoundError: as :func:`retrieve_file_path`.
    """
    model: torch.jit.ScriptModule = torch.jit.load(retrieve_file_path(model_path), map_location=device)
    return model.eval()
