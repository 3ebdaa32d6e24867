# SPDX-License-Identifier: Apache-2.0
"""Quadcopter: it flies to a goal and hovers there."""

from .direct_warp import QuadcopterEnv, QuadcopterEnvCfg, QuadcopterPPORunnerCfg

__all__ = ["QuadcopterEnv", "QuadcopterEnvCfg", "QuadcopterPPORunnerCfg"]
