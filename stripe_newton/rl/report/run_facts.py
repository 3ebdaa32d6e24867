# SPDX-License-Identifier: Apache-2.0
"""RunFacts: the device, versions and changed settings of a run, kept in its folder for its report."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import yaml

from stripe_newton.input_files import InputFileError, read_yaml
from stripe_newton.output_files import write_whole
from stripe_newton.rl.runs.run_folder import RunFolder

__all__ = ["RunFacts", "read_facts", "write_changes", "write_system"]

_SYSTEM, _CHANGES = "system.yaml", "changes.yaml"
_PACKAGES = ("stripe-newton", "newton", "warp-lang", "mujoco-warp", "torch", "rsl-rl-lib")
_NO_CHANGES = frozenset({"env.sim.device", "env.seed"})
"""Fields that always differ from the task's default: the device that was found, and the seed taken from the agent."""


@dataclass
class RunFacts:
    """Facts about a run from its folder, beside its configs and numbers."""

    system: dict[str, str] = field(default_factory=dict)
    """Device, versions and time of the start, by name; empty if the run does not say."""
    changes: dict[str, tuple[str, str]] | None = None
    """Fields of the configs that differ from the task's default: (default, value). None if the run does not say."""


def write_system(folder: RunFolder, device: str) -> None:
    """Write ``params/system.yaml``: the device by its name, versions of what computes, and the time.

    Raises:
        OSError: if the file cannot be written.
    """
    system = {"device": device_name(device), "python": platform.python_version(), "system": _system_name()}
    for package in _PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            system[package] = importlib.metadata.version(package)
    system["started"] = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")
    write_whole(folder.params / _SYSTEM, yaml.safe_dump(system, sort_keys=False))


def write_changes(folder: RunFolder, changes: Mapping[str, tuple[object, object]]) -> None:
    """Write ``params/changes.yaml``: the fields that differ from the task's default, as ``path: [default, value]``.

    Raises:
        OSError: if the file cannot be written.
    """
    shown = {path: [_text(value) for value in pair] for path, pair in changes.items() if path not in _NO_CHANGES}
    write_whole(folder.params / _CHANGES, yaml.safe_dump(shown, sort_keys=False, allow_unicode=True))


def read_facts(folder: RunFolder) -> RunFacts:
    """The facts of a run. What is missing or damaged is left out: a report is written without it."""
    system, changes = _read(folder.params / _SYSTEM), _read(folder.params / _CHANGES)
    pairs = None
    if changes is not None:
        both = {str(path): pair for path, pair in changes.items() if isinstance(pair, list) and len(pair) == 2}
        pairs = {path: (str(pair[0]), str(pair[1])) for path, pair in both.items()}
    return RunFacts({str(name): str(value) for name, value in (system or {}).items()}, pairs)


def device_name(device: str) -> str:
    """A device with the name of its processor, such as ``cuda:0 (NVIDIA H100 80GB HBM3)``."""
    import torch  # here, as reports are also read where nothing trains

    kind = torch.device(device)
    name = torch.cuda.get_device_name(kind) if kind.type == "cuda" else _processor()
    return f"{device} ({name})" if name else device


def _processor() -> str:
    """The processor's name; Python itself says only its architecture on Linux."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _system_name() -> str:
    return f"{platform.system()} {platform.machine()}"


def _text(value: object) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _read(file: Path) -> dict | None:
    if not file.is_file():
        return None
    try:
        data = read_yaml(file)
    except InputFileError:
        return None
    return data if isinstance(data, dict) else None
