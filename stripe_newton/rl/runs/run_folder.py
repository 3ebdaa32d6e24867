# SPDX-License-Identifier: Apache-2.0
"""RunFolder: the files of a training run; and the search for a checkpoint in it."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import yaml

from stripe_newton.configclass import Config
from stripe_newton.file_lock import FileLock
from stripe_newton.input_files import InputFileError, read_yaml, why_no_file
from stripe_newton.rl.configs.field_checks import why_no_folder_name
from stripe_newton.rl.errors import CheckpointError
from stripe_newton.value_types import short

__all__ = ["Params", "RunFolder", "find_checkpoint", "find_newest", "find_run", "newest_run_hint"]

_CHECKPOINT = re.compile(r"model_(\d{1,18})\.pt")
LOCK_NAME = "lock"
"""File by which a running training keeps others out."""

Params = dict[str, dict]
"""Configs of a run by ``"env"`` and ``"agent"``, as nested dicts of plain values."""


# libyaml's, the fast one, where it is built in.
_SafeDumper: type[yaml.SafeDumper] = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Dumper(_SafeDumper):
    """Safe YAML with lists of values on one line. It takes subclasses of the plain types too, as ``numpy.float64``."""

    def represent_list(self, data: list) -> yaml.Node:
        plain = not any(isinstance(item, (list, tuple, dict)) for item in data)
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=plain)


_Dumper.add_representer(list, _Dumper.represent_list)
_Dumper.add_multi_representer(float, lambda dumper, value: dumper.represent_float(float(value)))
_Dumper.add_multi_representer(str, lambda dumper, value: dumper.represent_str(str.__str__(value)))


@dataclass
class _Hold:
    """The hold of this process on a run folder."""

    lock: FileLock
    folder: int | None
    """Descriptor of the folder, None once it is given back. While it is open, no other folder can get its inode."""

    def is_folder_at(self, path: Path) -> bool:
        """Whether ``path`` still leads to the folder."""
        with contextlib.suppress(OSError):
            return self.folder is not None and os.path.samestat(os.fstat(self.folder), os.stat(path))
        return False

    def release(self) -> None:
        """Let other trainings use the folder; the second time this does nothing."""
        if self.folder is not None:
            os.close(self.folder)
            self.folder = None
        self.lock.release()


_held: dict[Path, _Hold] = {}
"""Run folders that this process holds."""


class RunFolder:
    """Paths of a run's files: ``params/``, ``checkpoints/``, ``videos/``, ``exported/``, ``metrics.csv`` and others."""

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
        """Make a new folder ``root/experiment/DATE_TIME[_run_name]``; a number is added if that one exists.

        Raises:
            ValueError: if a name leads out of ``root``, or has characters that no folder should have.
            OSError: if the folder cannot be made.
        """
        for what, name, parts in (("experiment", experiment, True), ("run_name", run_name, False)):
            if problem := why_no_folder_name(name, parts):
                raise ValueError(f"{what}: {problem}")
        stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S") + (f"_{run_name}" if run_name else "")
        for number in range(1, 1000):
            # `mkdir` fails if another process was faster, so two runs never share a folder.
            path = Path(root) / experiment / (stamp if number == 1 else f"{stamp}_{number}")
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                continue
            return cls(path)
        raise FileExistsError(f"{Path(root) / experiment}: a thousand runs within one second")

    @classmethod
    def of_checkpoint(cls, checkpoint: Path) -> RunFolder | None:
        """The run folder of a checkpoint or an exported policy, or None if the file is in no run folder."""
        # The second for a folder of checkpoints that is a link to another disk.
        for file in (checkpoint.resolve(), checkpoint.absolute()):
            run = cls(file.parent.parent)
            if file.parent in (run.checkpoints, run.exported) and run.params.is_dir():
                return run
        return None

    def list_checkpoints(self) -> list[tuple[int, Path]]:
        """(iteration, file) of every checkpoint, oldest first."""
        if not self.checkpoints.is_dir():
            return []
        matches = ((_CHECKPOINT.fullmatch(file.name), file) for file in self.checkpoints.iterdir())
        return sorted((int(match[1]), file) for match, file in matches if match)

    def set_aside_after(self, iteration: int) -> list[Path]:
        """Move checkpoints later than ``iteration`` to ``checkpoints/superseded``; returns their new paths.

        Half-written files of a process that was killed are removed.
        """
        # Left by a process that was killed while it wrote.
        for part in (*self.checkpoints.glob("*.part"), *self.params.glob("*.part"), *self.path.glob("*.part")):
            part.unlink(missing_ok=True)
        moved = []
        for number, file in self.list_checkpoints():
            if number > iteration:
                target = self.checkpoints / "superseded" / file.name
                target.parent.mkdir(exist_ok=True)
                os.replace(file, target)
                moved.append(target)
        return moved

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        """Keep other trainings out of the folder within this context. In one process it may be nested.

        Raises:
            CheckpointError: if another training holds it, with its process, host and time; or if a part of the folder
                is a link that leads out of it.
        """
        with self._says_os_errors():
            self.path.mkdir(parents=True, exist_ok=True)
        key = self.path.resolve()
        if key in _held:  # by an outer context
            yield
            return
        self.check_links()
        held = self._take()
        try:
            _held[key] = held
            yield
        finally:
            _held.pop(key, None)
            held.release()

    def _take(self) -> _Hold:
        """Lock the folder for this process."""
        lock = FileLock(self.path / LOCK_NAME)
        with self._says_os_errors():
            owner = lock.acquire()
            if owner is not None:
                raise CheckpointError(
                    f"{self.path}: another training runs in this folder: {owner}; wait until it has ended, or stop it"
                )
            try:
                return _Hold(lock, os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))
            except BaseException:
                lock.release()
                raise

    def take_anew_if_gone(self) -> bool:
        """If the folder that :meth:`hold` has locked is no longer at its path, make a new one there and lock that.

        Returns:
            Whether it was moved or deleted. False where nothing holds the folder.

        Raises:
            CheckpointError: if the new folder cannot be made, or another training holds it.
        """
        held = _held.get(self.path.resolve())
        if held is None or held.is_folder_at(self.path):
            return False
        held.release()  # first: on file systems without locks it would remove the mark of the new folder
        with self._says_os_errors():
            self.path.mkdir(parents=True, exist_ok=True)
        new = self._take()
        held.lock, held.folder = new.lock, new.folder
        return True

    @contextlib.contextmanager
    def _says_os_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CheckpointError(f"{self.path}: cannot be locked: {error.strerror or error}") from error

    def check_links(self, part: Path | None = None) -> None:
        """Check that what is written below the folder stays there.

        Args:
            part: A file or folder in it that is written; by default anything may be.

        Raises:
            CheckpointError: for a file or folder in it that is a link to another place.
        """
        root = self.path.resolve()
        inside = (Path(f, name) for f, *names in os.walk(part or self.path) for name in (*names[0], *names[1]))
        # Only links are resolved: a long run has thousands of checkpoints.
        for file in itertools.chain([] if part is None else [part], inside):
            if file.is_symlink() and not (target := Path(os.path.realpath(file))).is_relative_to(root):
                raise CheckpointError(f"{file}: is a link to {target}, outside of the run folder; remove it")

    def remove_unused(self) -> None:
        """Remove the folder of a run that did not begin, and that of its experiment if it was the only one.

        A folder with more than the configs in it is left alone.
        """
        if self.path.is_dir() and {file.name for file in self.path.iterdir()} <= {self.params.name, LOCK_NAME}:
            shutil.rmtree(self.path, ignore_errors=True)
            with contextlib.suppress(OSError):  # it has other runs
                self.path.parent.rmdir()

    def write_task(self, task: str) -> None:
        """Write the name of the task to ``params/run.yaml``."""
        self._write("run", yaml.safe_dump({"task": task}))

    def read_task(self) -> str | None:
        """The name of the task in ``params/run.yaml``, or None if there is none."""
        data = self._read("run") if os.path.lexists(self.params / "run.yaml") else {}
        task = data.get("task")
        if task is not None and not isinstance(task, str):
            raise CheckpointError(f"{self.params / 'run.yaml'}: task: is {short(task)}, must be text")
        return task

    def write_params(self, env_cfg: Config | Mapping, agent_cfg: Config | Mapping, num_envs: int | None = None) -> None:
        """Write ``params/env.yaml`` and ``params/agent.yaml``.

        Args:
            env_cfg: Config of the environment, or a dict.
            agent_cfg: Config of the agent, or a dict.
            num_envs: Number of environments of all ranks, where ``env_cfg`` has that of one rank.
        """
        for name, cfg in (("env", env_cfg), ("agent", agent_cfg)):
            data = cfg if isinstance(cfg, Mapping) else cfg.to_dict()
            # A resumed run reads the number of all ranks, as `--num-envs` is, and may have another number of ranks.
            scene = data.get("scene")
            if name == "env" and num_envs is not None and isinstance(scene, Mapping) and "num_envs" in scene:
                data = {**data, "scene": {**scene, "num_envs": num_envs}}
            text = yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False, default_flow_style=False, width=120)
            self._write(name, text)

    def read_params(self) -> Params:
        """Both configs as they were written.

        Raises:
            CheckpointError: if a file is missing or is no YAML.
        """
        return {name: self._read(name) for name in ("env", "agent")}

    def _write(self, name: str, text: str) -> None:
        """Write a file of ``params`` whole or not at all."""
        self.params.mkdir(parents=True, exist_ok=True)
        file = self.params / f"{name}.yaml"
        part = file.with_name(file.name + ".part")
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, file)
        except OSError as error:
            raise CheckpointError(f"{file}: could not be written: {error.strerror or error}") from error
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)

    def _read(self, name: str) -> dict:
        file = self.params / f"{name}.yaml"
        if not os.path.lexists(file):
            raise CheckpointError(f"{file}: is missing; is {self.path} a run folder?")
        try:
            data = read_yaml(file)
        except InputFileError as error:
            raise CheckpointError(str(error)) from None
        if not isinstance(data, dict):
            raise CheckpointError(f"{file}: contains {type(data).__name__}, expected a mapping")
        return data


def find_checkpoint(path: str | os.PathLike) -> Path:
    """The checkpoint file of ``path``: the file itself, or the newest complete one of a run folder.

    Newer checkpoints that are damaged are passed over with a warning.

    Raises:
        CheckpointError: if there is none, or if ``path`` is a damaged file and an earlier checkpoint is whole.
    """
    from .checkpoint import damage_of  # here, since it imports torch, which commands that only read configs do not need

    path = Path(path).expanduser()
    if path.is_file():
        found = find_newest(RunFolder(path.parent.parent), before=path) if damage_of(path) else None
        if found is not None:
            raise CheckpointError(f"{path}: {damage_of(path)}; the newest earlier one that is whole is {found}")
        return path
    if not path.exists():
        hint = newest_run_hint(path) or "give a run folder or a checkpoint file (model_K.pt)"
        raise CheckpointError(f"{path}: does not exist; {hint}")
    if not path.is_dir():
        raise CheckpointError(f"{path}: {why_no_file(path)}; give a run folder or a checkpoint file (model_K.pt)")
    run = RunFolder(path.parent if path.name == "checkpoints" else path)
    newest = find_newest(run)
    if newest is None:
        hint = newest_run_hint(path) or f"expected files {run.checkpoints.name}/model_K.pt in a run folder"
        raise CheckpointError(f"{path}: contains no checkpoint; {hint}")
    return newest


def newest_run_hint(path: Path) -> str:
    """Names the newest run in a folder of runs, or in the one that a path which does not exist would be in.

    Returns:
        Such as ``the newest run there is logs/cartpole/2026-01-31_12-00-00``; empty if there is no run.
    """
    folder = path if path.is_dir() else path.parent
    try:
        runs = [run for run in folder.iterdir() if (run / "checkpoints").is_dir()]
    except OSError:
        return ""
    # Their names are dates.
    return f"the newest run there is {max(runs, key=lambda run: run.name)}" if runs else ""


def find_newest(run: RunFolder, before: Path | None = None) -> Path | None:
    """The newest checkpoint of a run that is whole, or None if it has none. Each damaged one is a warning.

    Args:
        run: The run.
        before: Consider only checkpoints earlier than this file; then there are no warnings.

    Raises:
        CheckpointError: if all are damaged; with ``before`` the result is None.
    """
    from .checkpoint import damage_of  # see `find_checkpoint`

    # By number, not by time of change: copies of a folder may have any times.
    found = [file for _, file in run.list_checkpoints()]
    if before is not None:
        found = found[: found.index(before)] if before in found else []
    damaged: list[str] = []
    for file in reversed(found):
        damage = damage_of(file)
        if damage is None:
            for line in damaged if before is None else ():
                print(f"warning: {line}; taking {file.name} instead", file=sys.stderr)
            return file
        damaged.append(f"{file}: {damage}")
    if damaged and before is None:
        raise CheckpointError("no checkpoint is whole: " + "; ".join(damaged))
    return None


def find_run(path: str | os.PathLike) -> tuple[RunFolder | None, Path | None]:
    """The run and the checkpoint that ``--resume`` names.

    The run is None for a checkpoint that is in no run folder. The checkpoint is None for a run that ended before its
    first one, so that it begins anew.

    Raises:
        CheckpointError: if there is no such run or checkpoint, or a part of the run is a link that leads out of it.
    """
    path = Path(path).expanduser()
    run = RunFolder(path)
    if run.params.is_dir():
        run.check_links()
    if run.params.is_dir() and not run.list_checkpoints():
        run.read_params()  # which raises if they are damaged, before the run is built from them
        return run, None
    checkpoint = find_checkpoint(path)
    return RunFolder.of_checkpoint(checkpoint), checkpoint
