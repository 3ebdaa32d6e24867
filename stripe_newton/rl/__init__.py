# SPDX-License-Identifier: Apache-2.0
"""Training with rsl_rl: configs, runner, evaluation, run folders, export of policies, experiments.

Importing this package loads configs and errors alone. Names that need torch are imported at their first use.

=================  ==================================================================================
``configs``        configs of a run, its networks and its algorithm
``graphs``         rollout and update of PPO as CUDA graphs
``wrappers``       an environment as rsl_rl, Stable-Baselines3 and skrl expect it
``runs``           a run on disk: its folder, checkpoints, log, videos
``export``         a policy as ONNX and TorchScript
``distributed``    several processes that train one policy
``experiments``    sweeps over fields and seeds, comparisons of runs
``report``         the report of a run, written while it trains
=================  ==================================================================================
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING

from .configs import (
    RslRlBaseRunnerCfg,
    RslRlCNNModelCfg,
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    RslRlRecurrentCNNModelCfg,
    RslRlRndCfg,
    RslRlRNNModelCfg,
    RslRlSymmetryCfg,
)
from .errors import CheckpointError, DivergedError, ExportError

if TYPE_CHECKING:
    from .distillation import DistillationRunner
    from .evaluation import EvalResult, evaluate
    from .export import ExportedPolicy, export_policy
    from .export.onnx_policy import OnnxPolicy
    from .export.policy_metadata import describe_policy, read_policy_metadata
    from .policies import Policy, RandomPolicy, ZeroPolicy
    from .runner import OnPolicyRunner
    from .runs.checkpoint import load_checkpoint, save_checkpoint
    from .runs.learning_curve import plot_learning_curve
    from .runs.log_writers import RunLogWriter
    from .runs.metrics_csv import read_metrics
    from .runs.run_folder import RunFolder, find_checkpoint
    from .runs.video import TrainingVideo, record_video
    from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = [
    "CheckpointError",
    "DistillationRunner",
    "DivergedError",
    "EvalResult",
    "ExportError",
    "ExportedPolicy",
    "OnPolicyRunner",
    "OnnxPolicy",
    "Policy",
    "RandomPolicy",
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
    "RslRlVecEnvWrapper",
    "RunFolder",
    "RunLogWriter",
    "TrainingVideo",
    "ZeroPolicy",
    "describe_policy",
    "evaluate",
    "export_policy",
    "find_checkpoint",
    "load_checkpoint",
    "plot_learning_curve",
    "read_metrics",
    "read_policy_metadata",
    "record_video",
    "save_checkpoint",
]

_LAZY = {
    "DistillationRunner": "distillation",
    "EvalResult": "evaluation",
    "ExportedPolicy": "export",
    "OnPolicyRunner": "runner",
    "OnnxPolicy": "export.onnx_policy",
    "Policy": "policies",
    "RandomPolicy": "policies",
    "RslRlVecEnvWrapper": "wrappers.rsl_rl",
    "RunFolder": "runs.run_folder",
    "RunLogWriter": "runs.log_writers",
    "TrainingVideo": "runs.video",
    "ZeroPolicy": "policies",
    "describe_policy": "export.policy_metadata",
    "evaluate": "evaluation",
    "export_policy": "export",
    "find_checkpoint": "runs.run_folder",
    "load_checkpoint": "runs.checkpoint",
    "plot_learning_curve": "runs.learning_curve",
    "read_metrics": "runs.metrics_csv",
    "read_policy_metadata": "export.policy_metadata",
    "record_video": "runs.video",
    "save_checkpoint": "runs.checkpoint",
}
"""Module of each public name that needs torch."""

# rsl_rl imports GitPython, which raises on import where the program git is not installed.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    globals()[name] = value  # so that Python finds it without this function from the next time on
    return value
