# SPDX-License-Identifier: Apache-2.0
"""Cart-pole: balance a pole on a cart.

The package itself exports the direct form, from which the other forms take their numbers.
"""

from .direct import CartpoleEnv, CartpoleEnvCfg, CartpolePPORunnerCfg

__all__ = ["CartpoleEnv", "CartpoleEnvCfg", "CartpolePPORunnerCfg"]
