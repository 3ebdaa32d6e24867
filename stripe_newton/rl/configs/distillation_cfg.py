# SPDX-License-Identifier: Apache-2.0
"""Configs of distillation: a student learns to act like a teacher that was trained before."""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_newton.value_types import CodeName, PositiveFloat, PositiveInt

from .field_checks import Problems, one_of
from .model_cfg import RslRlMLPModelCfg
from .ppo_cfg import OPTIMIZERS
from .runner_cfg import RslRlBaseRunnerCfg

__all__ = ["RslRlDistillationAlgorithmCfg", "RslRlDistillationRunnerCfg"]


@configclass
class RslRlDistillationAlgorithmCfg:
    """Distillation: supervised learning of the teacher's actions in the states that the student visits."""

    class_name: CodeName = "Distillation"
    """Algorithm: rsl_rl's name or ``module:Class``."""
    num_learning_epochs: PositiveInt = 1
    """Epochs: passes over the steps of an iteration."""
    gradient_length: PositiveInt = 15
    """Steps whose losses are summed for one gradient step. It should divide ``num_steps_per_env``."""
    learning_rate: PositiveFloat = 1e-3
    """Learning rate."""
    max_grad_norm: PositiveFloat | None = None
    """Largest norm of the gradient, or ``None`` for no bound."""
    optimizer: str = "adam"
    """``"adam"``, ``"adamw"``, ``"sgd"`` or ``"rmsprop"``."""
    loss_type: str = "mse"
    """``"mse"`` or ``"huber"``."""
    use_mixed_precision: bool = False
    """Whether the networks run in bfloat16 during the update."""

    def problems(self) -> Problems:
        yield from one_of(self, "optimizer", OPTIMIZERS)
        yield from one_of(self, "loss_type", ("mse", "huber"))


@configclass
class RslRlDistillationRunnerCfg(RslRlBaseRunnerCfg):
    """A distillation run. The teacher must have the networks and observation groups of the run that trained it."""

    num_steps_per_env: PositiveInt = 120
    """Environment steps in an iteration."""
    obs_groups: dict[str, list[str]] = {"student": ["policy"], "teacher": ["policy"]}
    """Observation groups that the student and the teacher read, concatenated in this order."""
    student: RslRlMLPModelCfg = RslRlMLPModelCfg(
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.1)
    )
    """Network of the student. Its distribution is the noise on the actions that it takes."""
    teacher: RslRlMLPModelCfg = RslRlMLPModelCfg(distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg())
    """Network of the teacher."""
    teacher_checkpoint: str = ""
    """Run folder or checkpoint of the teacher. A resumed run has its teacher in its own checkpoint."""
    algorithm: RslRlDistillationAlgorithmCfg = RslRlDistillationAlgorithmCfg()
    """Hyperparameters of the distillation."""

    def problems(self) -> Problems:
        yield from super().problems()
        if self.student.distribution_cfg is None:
            must = "must be a distribution that actions are drawn from, RslRlMLPModelCfg.GaussianDistributionCfg()"
            yield "student.distribution_cfg", f"is None, {must}"
