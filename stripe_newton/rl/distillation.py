# SPDX-License-Identifier: Apache-2.0
"""DistillationRunner: trains a student on the actions of a trained teacher that observes more."""

from __future__ import annotations

import os

from .configs import RslRlDistillationRunnerCfg
from .errors import CheckpointError
from .runner import OnPolicyRunner
from .runs.checkpoint import load_checkpoint
from .runs.run_folder import find_checkpoint
from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["DistillationRunner"]


class DistillationRunner(OnPolicyRunner):
    """Trains a student on the actions of a teacher with rsl_rl's algorithm; otherwise as :class:`OnPolicyRunner`.

    Reference:
        Rusu et al. "Policy distillation", arXiv:1511.06295 (2016).
    """

    parts_to_act = {"student": True, "iteration": True}

    def __init__(
        self, env: RslRlVecEnvWrapper, cfg: RslRlDistillationRunnerCfg, log_dir: str | os.PathLike | None = None
    ):
        """Build networks, algorithm and logger, and load the teacher if ``cfg`` names one.

        A run that has checkpoints has its teacher in them: the teacher's own run is then not needed any more.

        Raises:
            ConfigError: all problems of ``cfg``, also those that depend on this environment.
            CheckpointError: if there is no teacher where ``cfg`` says, or it has other networks.
        """
        super().__init__(env, cfg, log_dir)
        if cfg.teacher_checkpoint and not (self.run_folder is not None and self.run_folder.list_checkpoints()):
            self.load_teacher(cfg.teacher_checkpoint)

    def load_teacher(self, path: str | os.PathLike) -> None:
        """Load the teacher from a run folder or a checkpoint of PPO.

        Raises:
            CheckpointError: if there is none, or it has other networks or observations.
        """
        file = find_checkpoint(path)
        # rsl_rl's algorithm loads the actor of PPO as its teacher.
        self._load_networks(load_checkpoint(file, self.device), {"teacher": True}, True, file)

    def learn(self, num_learning_iterations: int | None = None, init_at_random_ep_len: bool | None = None) -> bool:
        """See :meth:`OnPolicyRunner.learn`.

        Raises:
            CheckpointError: if no teacher was loaded.
        """
        if not self.alg.teacher_loaded:
            raise CheckpointError("teacher_checkpoint: is empty; give the run folder of the policy to learn from")
        return super().learn(num_learning_iterations, init_at_random_ep_len)
