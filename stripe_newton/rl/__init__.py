# SPDX-License-Identifier: Apache-2.0
"""Training with rsl_rl: configs, the environment's wrapper, the runner, evaluation, videos and export.

Configs and errors are light; what needs torch is imported when it is first asked for.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from .config import (
    RslRlBaseRunnerCfg,
    RslRlCNNModelCfg,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    RslRlRndCfg,
    RslRlRNNModelCfg,
    RslRlSymmetryCfg,
)
from .config_distillation import RslRlDistillationAlgorithmCfg, RslRlDistillationRunnerCfg
from .errors import CheckpointError, ExportError

if TYPE_CHECKING:
    from .checkpoint import load_checkpoint, save_checkpoint
    from .distillation import DistillationRunner
    from .evaluation import EvalResult, evaluate
    from .export import ExportedPolicy, export_policy
    from .metrics import RunLogWriter, read_metrics
    from .onnx_policy import OnnxPolicy
    from .plot import plot_learning_curve
    from .policies import Policy, RandomPolicy, ZeroPolicy
    from .policy_metadata import describe_policy, read_policy_metadata
    from .record import TrainingVideo, record_video
    from .run_folder import RunFolder, find_checkpoint
    from .runner import OnPolicyRunner
    from .vec_env import RslRlVecEnvWrapper

__all__ = [
    "CheckpointError",
    "DistillationRunner",
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
    "OnnxPolicy": "onnx_policy",
    "Policy": "policies",
    "RandomPolicy": "policies",
    "RslRlVecEnvWrapper": "vec_env",
    "RunFolder": "run_folder",
    "RunLogWriter": "metrics",
    "TrainingVideo": "record",
    "ZeroPolicy": "policies",
    "describe_policy": "policy_metadata",
    "evaluate": "evaluation",
    "export_policy": "export",
    "find_checkpoint": "run_folder",
    "load_checkpoint": "checkpoint",
    "plot_learning_curve": "plot",
    "read_metrics": "metrics",
    "read_policy_metadata": "policy_metadata",
    "record_video": "record",
    "save_checkpoint": "checkpoint",
}

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # rsl_rl imports GitPython, which fails where there is no git


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    globals()[name] = value
    return value
