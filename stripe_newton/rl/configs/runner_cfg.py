# SPDX-License-Identifier: Apache-2.0
"""Configs of a training run: length, checkpoints, observations, logger, networks and algorithm."""

from __future__ import annotations

import importlib.util

from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeInt, PositiveFloat, PositiveInt, Seed

from .field_checks import Problems, folder_names, one_of
from .model_cfg import RslRlMLPModelCfg, RslRlRNNModelCfg
from .ppo_cfg import RslRlPpoAlgorithmCfg

__all__ = ["RslRlBaseRunnerCfg", "RslRlOnPolicyRunnerCfg"]

LOG_WRITERS = {"wandb": "WandbLogWriter", "neptune": "NeptuneLogWriter"}
"""rsl_rl's writers by the package that they need."""
COMPILE_MODES = ("default", "max-autotune-no-cudagraphs")


def _is_installed(package: str) -> bool:
    spec = importlib.util.find_spec(package)
    return spec is not None and spec.origin is not None  # a folder of that name, as it leaves behind, has no origin


@configclass
class RslRlBaseRunnerCfg:
    """A training run: the fields that are the same for PPO and distillation."""

    seed: Seed = 42
    """Seed of Python, NumPy and torch, and of the environment unless that has a seed of its own."""
    num_steps_per_env: PositiveInt = 24
    """Environment steps in an iteration."""
    max_iterations: PositiveInt = 1500
    """Iterations of the whole run; those before a resume count."""
    save_interval: PositiveInt = 50
    """Iterations between checkpoints."""
    regenerate_interval: NonNegativeInt = 0
    """Iterations after which the scene is generated anew from its specification, 0 for never. The seed of the new
    scene is that of the config plus the number of scenes before it."""
    init_at_random_ep_len: bool = True
    """Whether the first episodes start at random lengths, so that episodes do not all end in the same step."""
    experiment_name: str = ""
    """Name of the folder of all runs of this experiment; empty for the name of the task."""
    run_name: str = ""
    """Suffix of the run folder's name."""
    obs_groups: dict[str, list[str]] = {}
    """Observation groups that each network reads, concatenated in this order."""
    clip_actions: PositiveFloat | None = None
    """Bound of the absolute value of every action, or ``None`` for none."""
    check_for_nan: bool = True
    """Whether NaN in observations or rewards ends the run with an error."""
    runner: str = "graph"
    """``"graph"``: rollout and update are CUDA graphs where that is possible. Where it is not, rsl_rl's own code runs,
    and a message says why. ``"rsl_rl"``: rsl_rl's loop and algorithm, unchanged."""
    matmul_precision: str = "high"
    """Precision of float32 matrix products on a GPU, as in ``torch.set_float32_matmul_precision``: ``"highest"``,
    ``"high"`` (TF32, as in the training of Isaac Lab and mjlab) or ``"medium"`` (bfloat16). On the CPU it is
    ``"highest"``."""
    torch_compile_mode: str | None = None
    """Mode of ``torch.compile`` for the networks (``"default"`` or ``"max-autotune-no-cudagraphs"``), or ``None``."""
    logger: str | dict[str, object] = "tensorboard"
    """``"tensorboard"``; ``"wandb"`` or ``"neptune"`` for a second writer beside it, or ``{"class_name": ..., ...}``
    for another one, by rsl_rl's name or as ``module:Class``."""
    log_project: str | None = None
    """Project of Weights & Biases or Neptune; by default ``experiment_name``."""

    def problems(self) -> Problems:
        yield from folder_names(self, "experiment_name", parts=True)
        yield from folder_names(self, "run_name")
        yield from one_of(self, "runner", ("graph", "rsl_rl"))
        yield from one_of(self, "matmul_precision", ("highest", "high", "medium"))
        if self.torch_compile_mode is not None:
            yield from one_of(self, "torch_compile_mode", COMPILE_MODES)
        for name, groups in self.obs_groups.items():
            if not isinstance(groups, (list, tuple)) or not groups:
                yield f"obs_groups.{name}", f"is {groups!r}, must be a list of observation groups"
        yield from self._logger_problems()

    def _logger_problems(self) -> Problems:
        if isinstance(self.logger, dict) and "class_name" in self.logger:
            return
        names = ("tensorboard", *LOG_WRITERS)
        if self.logger not in names:
            yield "logger", f"is {self.logger!r}, must be {', '.join(names)}, or a dict with a 'class_name'"
        elif self.logger != "tensorboard" and not _is_installed(str(self.logger)):
            yield "logger", f"is '{self.logger}', which is not installed: pip install {self.logger}"

    @property
    def second_writer(self) -> dict[str, object] | None:
        """rsl_rl's config of the writer beside tensorboard; None if there is none."""
        if isinstance(self.logger, dict):
            return self.logger
        if self.logger not in LOG_WRITERS:
            return None
        project = self.log_project or self.experiment_name or "stripe-newton"
        return {"class_name": LOG_WRITERS[self.logger], "project_name": project}

    def to_rsl_rl(self) -> dict[str, object]:
        """The nested dict that rsl_rl's runner expects; functions and classes are named as ``module:name``."""
        cfg = self.to_dict()
        for name in _UNKNOWN_TO_RSL_RL:
            cfg.pop(name, None)
        cfg["logger"] = self.second_writer or "tensorboard"
        return cfg


_UNKNOWN_TO_RSL_RL = (
    "experiment_name",
    "max_iterations",
    "init_at_random_ep_len",
    "log_project",
    "regenerate_interval",
    "runner",
    "matmul_precision",
    "teacher_checkpoint",
)
"""Fields that rsl_rl's runner does not have."""


@configclass
class RslRlOnPolicyRunnerCfg(RslRlBaseRunnerCfg):
    """A training run with PPO."""

    obs_groups: dict[str, list[str]] = {"actor": ["policy"], "critic": ["policy"]}
    """Observation groups that the actor, the critic and, with RND, ``rnd_state`` read, concatenated in this order."""
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg())
    """Network of the policy."""
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg()
    """Network of the value function."""
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg()
    """PPO's hyperparameters."""

    def problems(self) -> Problems:
        yield from super().problems()
        if self.actor.distribution_cfg is None:
            must = "must be a distribution that actions are drawn from, RslRlMLPModelCfg.GaussianDistributionCfg()"
            yield "actor.distribution_cfg", f"is None, {must}"
        if self.critic.distribution_cfg is not None:
            yield "critic.distribution_cfg", "must be None: a value is not drawn from a distribution"
        if self.algorithm.symmetry_cfg is not None:
            for name in ("actor", "critic"):
                if isinstance(getattr(self, name), RslRlRNNModelCfg):
                    yield name, "is recurrent, which algorithm.symmetry_cfg does not support"
