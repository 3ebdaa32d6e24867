# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's utilities: configs, math, noise, files."""

from .entries import Table, same

NAMES: dict[str, Table] = {
    "isaaclab.utils": same("stripe_newton.configclass", "configclass"),
}

ALIASES: dict[str, str] = {
    "isaaclab.utils.math": "stripe_newton.isaaclab.math",
    "isaaclab.utils.noise": "stripe_newton.noise",
}
