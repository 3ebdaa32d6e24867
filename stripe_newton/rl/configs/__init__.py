# SPDX-License-Identifier: Apache-2.0
"""Configs of a training with rsl_rl 5.5: the run, its networks, PPO and distillation.

The class names are those of Isaac Lab, the fields are those of rsl_rl. Nothing here imports torch.
"""

from __future__ import annotations

from typing import TypeAlias

from stripe_newton.configclass import Config

from .distillation_cfg import RslRlDistillationAlgorithmCfg, RslRlDistillationRunnerCfg
from .model_cfg import RslRlCNNModelCfg, RslRlMLPModelCfg, RslRlRecurrentCNNModelCfg, RslRlRNNModelCfg
from .ppo_cfg import RslRlPpoAlgorithmCfg, RslRlRndCfg, RslRlSymmetryCfg
from .runner_cfg import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg

RunnerCfg: TypeAlias = RslRlOnPolicyRunnerCfg | RslRlDistillationRunnerCfg
"""Config of a run of either kind."""

__all__ = [
    "Config",
    "RslRlBaseRunnerCfg",
    "RslRlCNNModelCfg",
    "RslRlDistillationAlgorithmCfg",
    "RslRlDistillationRunnerCfg",
    "RslRlMLPModelCfg",
    "RslRlOnPolicyRunnerCfg",
    "RslRlPpoAlgorithmCfg",
    "RslRlRNNModelCfg",
    "RslRlRecurrentCNNModelCfg",
    "RslRlRndCfg",
    "RslRlSymmetryCfg",
    "RunnerCfg",
]
