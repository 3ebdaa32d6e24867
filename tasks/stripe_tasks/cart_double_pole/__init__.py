# SPDX-License-Identifier: Apache-2.0
"""Cart with two poles: balance them, with one agent or with two.

The package itself exports the form with one agent.
"""

from .direct import CartDoublePoleEnv, CartDoublePoleEnvCfg, CartDoublePolePPORunnerCfg

__all__ = ["CartDoublePoleEnv", "CartDoublePoleEnvCfg", "CartDoublePolePPORunnerCfg"]
