# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's environments, managers and terms."""

from .entries import Table, dialect, inert, refused, same
from .modules import SUBMODULES

_MDP = [name for name in SUBMODULES["isaaclab.envs"].split() if name == "mdp" or name.startswith("mdp.")]
_ROBOT_FREE = "the controller is not available here"

NAMES: dict[str, Table] = {
    "isaaclab.envs": dialect("direct_envs", "DirectRLEnv DirectRLEnvCfg DirectMARLEnv DirectMARLEnvCfg")
    | dialect("manager_envs", "ManagerBasedEnv ManagerBasedEnvCfg ManagerBasedRLEnv ManagerBasedRLEnvCfg")
    | dialect("simulation_cfg", "ViewerCfg")
    | dialect("env_types", "ActionType AgentID EnvStepReturn ObsType SpaceType StateType VecEnvObs VecEnvStepReturn")
    | refused("mimic generates data by Isaac Sim's tools", "ManagerBasedRLMimicEnv MimicEnvCfg SubTaskConfig"),
    "isaaclab.envs.mdp": refused(
        _ROBOT_FREE,
        """PinkInverseKinematicsActionCfg RMPFlowActionCfg SurfaceGripperBinaryActionCfg""",
    )
    | refused("the ground and what stands on it is made once for all environments", "randomize_rigid_body_scale")
    | refused("deformable bodies are not simulated", "reset_nodal_state_uniform")
    | refused("textures are not drawn", "randomize_visual_texture_material")
    | refused("pretrained networks are not downloaded; use a class term with one of your own", "image_features"),
    "isaaclab.envs.ui": inert("there are no windows", "BaseEnvWindow ManagerBasedRLEnvWindow ViewportCameraController"),
    "isaaclab.managers": same(
        "stripe_newton.managers",
        """ActionManager ActionTerm CommandManager CommandTerm CurriculumManager CurriculumTermCfg DatasetExportMode
        EventManager EventTermCfg ManagerTermBase ObservationGroupCfg RecorderManager
        RecorderTerm RecorderTermCfg RewardManager RewardTermCfg TerminationManager TerminationTermCfg""",
    )
    | dialect("managers", "ObservationManager")
    | dialect("manager_base", "ManagerBase")
    | dialect("scene_entity", "SceneEntityCfg")
    | dialect(
        "term_configs", "ActionTermCfg CommandTermCfg ManagerTermBaseCfg ObservationTermCfg RecorderManagerBaseCfg"
    ),
}

ALIASES: dict[str, str] = {f"isaaclab.envs.{name}": "stripe_newton.isaaclab.mdp" for name in _MDP}
