# SPDX-License-Identifier: Apache-2.0
"""Environments."""

from stripe_newton.managers import EventTermCfg

from .direct_rl_env import DirectRLEnv
from .direct_rl_env_cfg import DirectRLEnvCfg
from .manager_based_rl_env import ManagerBasedRLEnv
from .manager_based_rl_env_cfg import DefaultEventsCfg, ManagerBasedRLEnvCfg
from .rl_env import RLEnv
from .rl_env_cfg import RLEnvCfg
from .spaces import to_space

__all__ = [
    "DefaultEventsCfg",
    "DirectRLEnv",
    "DirectRLEnvCfg",
    "EventTermCfg",
    "ManagerBasedRLEnv",
    "ManagerBasedRLEnvCfg",
    "RLEnv",
    "RLEnvCfg",
    "to_space",
]
