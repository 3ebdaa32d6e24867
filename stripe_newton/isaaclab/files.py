# SPDX-License-Identifier: Apache-2.0
"""Files by name: folders of NVIDIA's asset server as names, and the functions that read files."""

from __future__ import annotations

import io
from pathlib import Path

import torch

__all__ = [
    "ISAACLAB_NUCLEUS_DIR",
    "ISAAC_NUCLEUS_DIR",
    "NUCLEUS_ASSET_ROOT_DIR",
    "NVIDIA_NUCLEUS_DIR",
    "check_file_path",
    "load_torchscript_model",
    "read_file",
    "retrieve_file_path",
]

NUCLEUS_ASSET_ROOT_DIR = "nucleus:/"
"""Root of NVIDIA's asset server. No file is below it: a path is a name, which is resolved when it is needed."""
NVIDIA_NUCLEUS_DIR = f"{NUCLEUS_ASSET_ROOT_DIR}/NVIDIA"
"""Folder of materials and skies."""
ISAAC_NUCLEUS_DIR = f"{NUCLEUS_ASSET_ROOT_DIR}/Isaac"
"""Folder of Isaac Sim's robots and props."""
ISAACLAB_NUCLEUS_DIR = f"{ISAAC_NUCLEUS_DIR}/IsaacLab"
"""Folder of Isaac Lab's robots."""


def check_file_path(path: str) -> int:
    """1 if a file is on this machine, 0 if not; nothing is on a server (2 in Isaac Lab)."""
    return int(not path.startswith(NUCLEUS_ASSET_ROOT_DIR) and Path(path).is_file())


def retrieve_file_path(path: str, download_dir: str | None = None, force_download: bool = True) -> str:
    """The absolute path of a file on this machine.

    Raises:
        FileNotFoundError: there is no such file, or only NVIDIA's server has it.
    """
    if path.startswith(NUCLEUS_ASSET_ROOT_DIR):
        raise FileNotFoundError(
            f"'{path.removeprefix(NUCLEUS_ASSET_ROOT_DIR + '/')}' is on NVIDIA's asset server, which the Isaac Lab "
            "dialect does not read; give the path of a file of your own in its place"
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
