# SPDX-License-Identifier: Apache-2.0
"""Environments."""

from .direct_rl_env import DirectRLEnv
from .direct_rl_env_cfg import DirectRLEnvCfg
from .events import EventTermCfg
from .spaces import to_space

__all__ = ["DirectRLEnv", "DirectRLEnvCfg", "EventTermCfg", "to_space"]
