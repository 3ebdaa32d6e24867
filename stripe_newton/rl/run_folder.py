# SPDX-License-Identifier: Apache-2.0
"""The folder of a training run, and how a checkpoint in it is found."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from .errors import CheckpointError

__all__ = ["RunFolder", "find_checkpoint"]

_CHECKPOINT = re.compile(r"model_(\d+)\.pt")


class _Dumper(yaml.SafeDumper):
    """Safe YAML that takes subclasses of the plain types too (``numpy.float64``), with lists of values on one line."""

    def represent_list(self, data: list) -> yaml.Node:
        plain = not any(isinstance(item, (list, tuple, dict)) for item in data)
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=plain)


_Dumper.add_representer(list, _Dumper.represent_list)
_Dumper.add_multi_representer(float, lambda dumper, value: dumper.represent_float(float(value)))
_Dumper.add_multi_representer(str, lambda dumper, value: dumper.represent_str(str.__str__(value)))


class RunFolder:
    """``params/``, ``checkpoints/``, ``videos/``, ``exported/``, ``metrics.csv``, ``learning_curve.png`` and events."""

    def __init__(self, path: str | os.PathLike):
        self.path = Path(path)
        self.checkpoints = self.path / "checkpoints"
        self.params = self.path / "params"
        self.videos = self.path / "videos"
        self.exported = self.path / "exported"
        self.metrics = self.path / "metrics.csv"
        self.learning_curve = self.path / "learning_curve.png"

    @classmethod
    def create(cls, root: str | os.PathLike, experiment: str, run_name: str = "") -> RunFolder:
        """A new folder ``root/experiment/DATE_TIME[_run_name]``; a number is added if that one exists."""
        stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S") + (f"_{run_name}" if run_name else "")
        for number in range(1, 1000):
            path = Path(root) / experiment / (stamp if number == 1 else f"{stamp}_{number}")
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                continue
            return cls(path)
        raise FileExistsError(f"{Path(root) / experiment}: a thousand runs within one second")

    @classmethod
    def of_checkpoint(cls, checkpoint: Path) -> RunFolder | None:
        """The run folder that a checkpoint belongs to, or None if it stands alone."""
        run = cls(checkpoint.resolve().parent.parent)
        return run if checkpoint.resolve().parent == run.checkpoints and run.params.is_dir() else None

    def list_checkpoints(self) -> list[tuple[int, Path]]:
        """(iteration, file) of every checkpoint, oldest first."""
        if not self.checkpoints.is_dir():
            return []
        matches = ((_CHECKPOINT.fullmatch(file.name), file) for file in self.checkpoints.iterdir())
        return sorted((int(match[1]), file) for match, file in matches if match)

    def set_aside_after(self, iteration: int) -> list[Path]:
        """Move checkpoints later than ``iteration`` to ``checkpoints/superseded``; returns where they are now."""
        moved = []
        for number, file in self.list_checkpoints():
            if number > iteration:
                target = self.checkpoints / "superseded" / file.name
                target.parent.mkdir(exist_ok=True)
                os.replace(file, target)
                moved.append(target)
        return moved

    def write_task(self, task: str) -> None:
        """Note in ``params/run.yaml`` of which task this run is."""
        self.params.mkdir(parents=True, exist_ok=True)
        (self.params / "run.yaml").write_text(yaml.safe_dump({"task": task}), encoding="utf-8")

    def read_task(self) -> str | None:
        """The task that :meth:`write_task` noted, or None."""
        data = self._read("run") if (self.params / "run.yaml").exists() else {}
        return data.get("task")

    def write_params(self, env_cfg: Any, agent_cfg: Any) -> None:
        """Write ``params/env.yaml`` and ``params/agent.yaml`` from configs or dicts."""
        self.params.mkdir(parents=True, exist_ok=True)
        for name, cfg in (("env", env_cfg), ("agent", agent_cfg)):
            data = cfg if isinstance(cfg, Mapping) else cfg.to_dict()
            text = yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False, default_flow_style=False, width=120)
            (self.params / f"{name}.yaml").write_text(text, encoding="utf-8")

    def read_params(self) -> dict[str, dict[str, Any]]:
        """``{"env": ..., "agent": ...}`` as they were written.

        Raises:
            CheckpointError: a file that is missing or is no YAML.
        """
        return {name: self._read(name) for name in ("env", "agent")}

    def _read(self, name: str) -> dict[str, Any]:
        file = self.params / f"{name}.yaml"
        try:
            data = yaml.safe_load(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise CheckpointError(f"{file}: is missing; is {self.path} a run folder?") from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise CheckpointError(f"{file}: is no valid YAML ({str(error).splitlines()[0]})") from None
        if not isinstance(data, dict):
            raise CheckpointError(f"{file}: holds {type(data).__name__}, expected a mapping")
        return data


def find_checkpoint(path: str | os.PathLike) -> Path:
    """The checkpoint file that ``path`` means: the file itself, or the newest one of a run folder.

    Raises:
        CheckpointError: if there is none.
    """
    path = Path(path).expanduser()
    if path.is_file():
        return path
    if not path.exists():
        raise CheckpointError(f"{path}: does not exist; give a run folder or a checkpoint file (model_K.pt)")
    run = RunFolder(path.parent if path.name == "checkpoints" else path)
    found = run.list_checkpoints()
    if not found:
        raise CheckpointError(
            f"{path}: holds no checkpoint; expected files {run.checkpoints.name}/model_K.pt in a run folder"
        )
    return found[-1][1]
