# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's environments, managers and terms."""

from .entries import Table, dialect, same

NAMES: dict[str, Table] = {
    "isaaclab.envs": same(
        "stripe_newton.envs",
        "ManagerBasedRLEnv ManagerBasedRLEnvCfg",
    )
    | dialect("direct_envs", "DirectRLEnv DirectRLEnvCfg DirectMARLEnv DirectMARLEnvCfg")
    | dialect("simulation_cfg", "ViewerCfg"),
    "isaaclab.managers": same(
        "stripe_newton.managers",
        """EventTermCfg SceneEntityCfg ObservationGroupCfg ObservationTermCfg RewardTermCfg TerminationTermCfg
        CurriculumTermCfg RecorderTerm RecorderTermCfg RecorderManagerBaseCfg""",
    ),
}

ALIASES: dict[str, str] = {"isaaclab.envs.mdp": "stripe_newton.envs.mdp"}
