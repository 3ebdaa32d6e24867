# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's environments, managers and terms."""

from .entries import Table, dialect, same

NAMES: dict[str, Table] = {
    "isaaclab.envs": same(
        "stripe_newton.envs",
        "DirectRLEnvCfg DirectMARLEnvCfg ManagerBasedRLEnv ManagerBasedRLEnvCfg",
    )
    | dialect("direct_envs", "DirectRLEnv DirectMARLEnv")
    | same("stripe_newton.viewers", "ViewerCfg"),
    "isaaclab.managers": same(
        "stripe_newton.managers",
        """EventTermCfg SceneEntityCfg ObservationGroupCfg ObservationTermCfg RewardTermCfg TerminationTermCfg
        CurriculumTermCfg RecorderTerm RecorderTermCfg RecorderManagerBaseCfg""",
    ),
}

ALIASES: dict[str, str] = {"isaaclab.envs.mdp": "stripe_newton.envs.mdp"}
