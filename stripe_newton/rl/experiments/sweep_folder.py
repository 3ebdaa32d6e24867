# SPDX-License-Identifier: Apache-2.0
"""Folder of a sweep: its lock, its config, and optuna's study in a journal file."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from pathlib import Path

import optuna
import yaml
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from stripe_newton.file_lock import FileLock
from stripe_newton.input_files import InputFileError, read_yaml

from .sweep_cfg import SweepCfg

__all__ = ["SweepError", "lock_folder", "open_study", "write_cfg"]

_SAVING_SECONDS = 120.0
"""Time to wait for the runs of a killed sweep, which save before they end [s]."""


class SweepError(Exception):
    """A sweep that cannot be started or continued."""


def lock_folder(folder: Path, show: Callable[[str], None]) -> FileLock:
    """Lock a folder for this process and for those that inherit the lock.

    The runs of a sweep inherit it. So they still hold it after the sweep was killed, until they have saved.

    Args:
        folder: The folder.
        show: Called with a line of text if this has to wait.

    Raises:
        SweepError: if a sweep is running in it.
    """
    lock = FileLock(folder / "lock")
    end = time.monotonic() + _SAVING_SECONDS
    for attempt in itertools.count():
        owner = lock.acquire()
        if owner is None:
            return lock
        # The owner tells a sweep that runs from one whose runs are still saving.
        if not owner.is_dead() or time.monotonic() > end:
            raise SweepError(f"{folder}: a sweep is running here ({owner})")
        if attempt == 0:
            show("waiting for the runs of the earlier sweep to save")
        time.sleep(0.5)
    raise AssertionError("the loop has no end")


def write_cfg(folder: Path, cfg: SweepCfg) -> None:
    """Write ``sweep.yaml``.

    Raises:
        SweepError: if there is one, of another sweep.
    """
    path = folder / "sweep.yaml"
    if path.exists():
        try:
            before = read_yaml(path) or {}
        except InputFileError as error:
            raise SweepError(f"{error}; delete it, or give this sweep a 'name' of its own") from None
        if not isinstance(before, dict):
            raise SweepError(f"{path}: contains {type(before).__name__}, must be the settings of a sweep")
        differences = cfg.differences(before)
        if differences:
            raise SweepError(
                f"{folder}: contains another sweep, which cannot continue as this one: {'; '.join(differences)}. "
                "Give this one a 'name' of its own, or delete that folder"
            )
    part = path.with_name("sweep.yaml.part")
    part.write_text(yaml.safe_dump(cfg.to_dict(), sort_keys=False), encoding="utf-8")
    os.replace(part, path)


def open_study(folder: Path, cfg: SweepCfg, parallel: bool = False) -> optuna.Study:
    """Open the study of a locked folder, a new one or that of an earlier process.

    Args:
        folder: Folder of ``study.journal``.
        cfg: The sweep.
        parallel: Whether several trials will run at the same time.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    journal = folder / "study.journal"
    # optuna's own lock, left by a sweep that was killed. This process holds the folder's.
    Path(f"{journal}.lock").unlink(missing_ok=True)
    _cut_half_line(journal)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(journal))),
        study_name=cfg.task,
        direction="maximize" if cfg.maximize else "minimize",
        load_if_exists=True,
    )
    # The seed differs for each process that continues the study: the same one would propose the same trials again.
    begun = len(study.get_trials(deepcopy=False))
    if cfg.sampler == "tpe":
        study.sampler = optuna.samplers.TPESampler(seed=begun, constant_liar=parallel)
    else:
        study.sampler = optuna.samplers.RandomSampler(seed=begun)
    if cfg.sampler == "grid":
        # Trials that were proposed before are skipped, so that the grid continues where it stopped.
        for values in itertools.product(*(space.choices for space in cfg.spaces.values())):
            study.enqueue_trial(dict(zip(cfg.spaces, values)), skip_if_exists=True)
    study.pruner = optuna.pruners.NopPruner()
    if cfg.pruner is not None:
        study.pruner = optuna.pruners.MedianPruner(
            cfg.pruner.startup_trials, cfg.pruner.warmup_iterations, cfg.pruner.interval_iterations
        )
    return study


def _cut_half_line(journal: Path) -> None:
    """Drop the last line of a journal if a killed process left half of it."""
    data = journal.read_bytes() if journal.exists() else b""
    if data and not data.endswith(b"\n"):
        journal.write_bytes(data[: data.rfind(b"\n") + 1])
