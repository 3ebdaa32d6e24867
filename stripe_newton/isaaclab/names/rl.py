# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's packages of learners."""

from .entries import Table, dialect, refused, same

_NO_DISTILLATION = "the dialect does not translate distillation; stripe_newton.rl has RslRlDistillationRunnerCfg"
_NOT_PUBLISHED = "NVIDIA's trained policies act on its own robots, and are not downloaded"

NAMES: dict[str, Table] = {
    "isaaclab_rl": {},
    "isaaclab_rl.rl_games": refused(
        "rl_games is not supported; use rsl_rl, sb3 or skrl",
        "MultiObserver PbtAlgoObserver RlGamesGpuEnv RlGamesVecEnvWrapper",
    ),
    "isaaclab_rl.rsl_rl": dialect(
        "rl_configs",
        """RslRlBaseRunnerCfg RslRlOnPolicyRunnerCfg RslRlPpoActorCriticCfg RslRlPpoActorCriticRecurrentCfg
        RslRlPpoAlgorithmCfg RslRlRndCfg RslRlSymmetryCfg""",
    )
    | same("stripe_newton.rl", "RslRlCNNModelCfg RslRlMLPModelCfg RslRlRNNModelCfg RslRlVecEnvWrapper")
    | refused(
        _NO_DISTILLATION,
        """RslRlDistillationAlgorithmCfg RslRlDistillationRunnerCfg RslRlDistillationStudentTeacherCfg
        RslRlDistillationStudentTeacherRecurrentCfg""",
    )
    | refused("use 'stripe-newton export'", "export_policy_as_jit export_policy_as_onnx"),
    "isaaclab_rl.sb3": same("stripe_newton.rl.wrappers.sb3", "Sb3VecEnvWrapper"),
    "isaaclab_rl.skrl": same("stripe_newton.rl.wrappers.skrl", "SkrlVecEnvWrapper"),
    "isaaclab_rl.utils.pretrained_checkpoint": refused(
        _NOT_PUBLISHED,
        """WORKFLOW_EXPERIMENT_NAME_VARIABLE WORKFLOW_PLAYER WORKFLOW_TRAINER WORKFLOWS
        get_published_pretrained_checkpoint get_pretrained_checkpoint_path has_pretrained_checkpoint_job_run""",
    ),
}

ALIASES: dict[str, str] = {}
