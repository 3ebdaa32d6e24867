# SPDX-License-Identifier: Apache-2.0
"""Configuration of a distillation: a student learns to act as a teacher does that was trained before."""

from __future__ import annotations

from stripe_newton.configclass import configclass

from .config import (
    OPTIMIZERS,
    Problems,
    RslRlBaseRunnerCfg,
    RslRlMLPModelCfg,
    at_least,
    one_of,
    positive,
)

__all__ = ["RslRlDistillationAlgorithmCfg", "RslRlDistillationRunnerCfg"]


@configclass
class RslRlDistillationAlgorithmCfg:
    """Supervised learning of the teacher's actions on what the student does."""

    class_name: str = "Distillation"
    """Algorithm: rsl_rl's name or ``module:Class``."""
    num_learning_epochs: int = 1
    """Passes over the steps of an iteration."""
    gradient_length: int = 15
    """Steps whose losses are summed up for one gradient step; it should divide the steps of an iteration."""
    learning_rate: float = 1e-3
    """Step size of the optimizer."""
    max_grad_norm: float | None = None
    """Bound of the gradient's norm, or ``None``."""
    optimizer: str = "adam"
    """``"adam"``, ``"adamw"``, ``"sgd"`` or ``"rmsprop"``."""
    loss_type: str = "mse"
    """``"mse"`` or ``"huber"``."""
    use_mixed_precision: bool = False
    """Whether the networks compute in bfloat16."""

    def problems(self) -> Problems:
        yield from at_least(self, 1, "num_learning_epochs", "gradient_length")
        yield from positive(self, "learning_rate")
        if self.max_grad_norm is not None:
            yield from positive(self, "max_grad_norm")
        yield from one_of(self, "optimizer", OPTIMIZERS)
        yield from one_of(self, "loss_type", ("mse", "huber"))


@configclass
class RslRlDistillationRunnerCfg(RslRlBaseRunnerCfg):
    """A distillation run. The teacher's network and observations are those of the run that it comes from."""

    num_steps_per_env: int = 120
    """Environment steps in an iteration."""
    obs_groups: dict[str, list[str]] = {"student": ["policy"], "teacher": ["policy"]}
    """Which observation groups the student and the teacher read, joined in this order."""
    student: RslRlMLPModelCfg = RslRlMLPModelCfg(
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.1)
    )
    """The student's network; it draws its actions with this noise."""
    teacher: RslRlMLPModelCfg = RslRlMLPModelCfg(distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg())
    """The teacher's network."""
    teacher_checkpoint: str = ""
    """A run folder or checkpoint of the teacher. A run that goes on has its teacher already."""
    algorithm: RslRlDistillationAlgorithmCfg = RslRlDistillationAlgorithmCfg()
    """The algorithm."""

    def problems(self) -> Problems:
        yield from super().problems()
        if self.student.distribution_cfg is None:
            yield "student.distribution_cfg", "is None, must be a distribution: the student draws its actions from it"
