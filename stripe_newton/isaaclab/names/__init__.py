# SPDX-License-Identifier: Apache-2.0
"""Name tables of the Isaac Lab dialect: what each name of each module stands for, one file for each area."""

from . import apps, assets, devices, envs, rl, sensors, sim, utils
from .entries import Table
from .modules import SUBMODULES

__all__ = ["ALIASES", "MODULES", "NAMES", "PACKAGES"]

_AREAS = (apps, assets, devices, envs, rl, sensors, sim, utils)

PACKAGES = ("isaaclab", "isaaclab_assets", "isaaclab_rl", "isaaclab_tasks", "isaacsim", "omni", "carb")
"""Top-level packages of Isaac Lab and Isaac Sim."""

NAMES: dict[str, Table] = {module: table for area in _AREAS for module, table in area.NAMES.items()}
"""Entry by name, by module. Submodules without a table of their own have that of the nearest package."""

ALIASES: dict[str, str] = {module: target for area in _AREAS for module, target in area.ALIASES.items()}
"""Modules of stripe_newton by modules of Isaac Lab that they stand for as a whole."""

MODULES: frozenset[str] = frozenset(
    [*SUBMODULES, *NAMES, *ALIASES, *(f"{top}.{sub}" for top, subs in SUBMODULES.items() for sub in subs.split())]
)
"""Every module that can be imported."""
