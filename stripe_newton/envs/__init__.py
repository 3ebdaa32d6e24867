# SPDX-License-Identifier: Apache-2.0
"""Environments: the direct workflow, for one agent or several, and the manager-based workflow."""

from stripe_newton.managers import EventTermCfg
from stripe_newton.viewers import ViewerCfg

from .direct_marl_env import DirectMARLEnv, DirectMARLEnvCfg
from .direct_rl_env import DirectRLEnv, DirectRLEnvCfg
from .lab_scene import LabScene, LabSceneCfg
from .manager_based_env import ManagerBasedEnv, ManagerBasedEnvCfg
from .manager_based_rl_env import ManagerBasedRLEnv
from .manager_based_rl_env_cfg import DefaultEventsCfg, ManagerBasedRLEnvCfg
from .multi_agent import ParallelEnvView, SingleAgentView, multi_agent_to_single_agent
from .rl_env import RLEnv
from .rl_env_cfg import RLEnvCfg
from .spaces import to_space

__all__ = [
    "DefaultEventsCfg",
    "DirectMARLEnv",
    "DirectMARLEnvCfg",
    "DirectRLEnv",
    "DirectRLEnvCfg",
    "EventTermCfg",
    "LabScene",
    "LabSceneCfg",
    "ManagerBasedEnv",
    "ManagerBasedEnvCfg",
    "ManagerBasedRLEnv",
    "ManagerBasedRLEnvCfg",
    "ParallelEnvView",
    "RLEnv",
    "RLEnvCfg",
    "SingleAgentView",
    "ViewerCfg",
    "multi_agent_to_single_agent",
    "to_space",
]
