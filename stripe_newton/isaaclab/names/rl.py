# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's packages of robots and learners."""

from .entries import Table, same

NAMES: dict[str, Table] = {
    "isaaclab_rl.rsl_rl": same("stripe_newton.rl", "RslRlOnPolicyRunnerCfg RslRlPpoAlgorithmCfg"),
}

ALIASES: dict[str, str] = {}
