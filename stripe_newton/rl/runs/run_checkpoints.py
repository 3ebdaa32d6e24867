# SPDX-License-Identifier: Apache-2.0
"""Run checkpoints: the checkpoints of a run as policies that a viewer can switch between."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from .run_folder import RunFolder
from .training_state import restore_normalization

if TYPE_CHECKING:
    from stripe_newton.rl.runner import OnPolicyRunner

__all__ = ["RunCheckpoints"]


class RunCheckpoints:
    """Loads checkpoints of a run into the networks of a runner that only acts.

    The policy that the runner has given out stays the same object, with other weights.

    Args:
        runner: The runner.
        checkpoint: The checkpoint that is loaded.
        loaded: Called after another one was loaded.

    Attributes:
        current: Name of the one that acts.
    """

    def __init__(self, runner: OnPolicyRunner, checkpoint: Path, loaded: Callable[[], None]):
        self._runner, self._loaded = runner, loaded
        self._folder = RunFolder.of_checkpoint(checkpoint)
        self._alone = checkpoint
        self.current = checkpoint.stem

    def names(self) -> list[str]:
        """Names of the present checkpoints, the newest last; a file in no run folder is the only one."""
        if self._folder is None:
            return [self._alone.stem]
        return [path.stem for _, path in sorted(self._folder.list_checkpoints())]

    @torch.inference_mode(False)
    def load(self, name: str) -> None:
        """Let a checkpoint act.

        Raises:
            CheckpointError: if it is missing, damaged, or of other networks.
            DivergedError: if its weights are not finite.
        """
        paths = {} if self._folder is None else {path.stem: path for _, path in self._folder.list_checkpoints()}
        path = paths.get(name, self._alone.with_name(f"{name}.pt"))
        self._runner.load(path, load_cfg=self._runner.parts_to_act)
        restore_normalization(self._runner.env.unwrapped, path)
        # The runner sets modes of its own while it loads.
        self._runner.get_inference_policy(self._runner.device)
        self.current = name
        self._loaded()
