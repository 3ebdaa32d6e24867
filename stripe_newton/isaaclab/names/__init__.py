# SPDX-License-Identifier: Apache-2.0
"""Name tables of the Isaac Lab dialect: what each name of each module stands for, one file for each area."""

from . import apps, assets, devices, envs, gaps, rl, sensors, sim, terrains, utils
from .entries import Table
from .modules import SUBMODULES

__all__ = ["ALIASES", "MODULES", "NAMES", "PACKAGES"]

_AREAS = (apps, assets, devices, envs, rl, sensors, sim, terrains, utils)

PACKAGES = (
    "isaaclab",
    "isaaclab_assets",
    "isaaclab_contrib",
    "isaaclab_rl",
    "isaaclab_tasks",
    "isaacsim",
    "omni",
    "carb",
)
"""Top-level packages of Isaac Lab and Isaac Sim."""

NAMES: dict[str, Table] = {
    module: {name: entry for area in (gaps, *_AREAS) for name, entry in area.NAMES.get(module, {}).items()}
    for module in {module: None for area in (gaps, *_AREAS) for module in area.NAMES}
}
"""Entry by name, by module. Submodules without a table of their own have that of the nearest package."""

ALIASES: dict[str, str] = {module: target for area in _AREAS for module, target in area.ALIASES.items()}
"""Modules of stripe_newton by modules of Isaac Lab that they stand for as a whole."""

_NAMED = [*SUBMODULES, *NAMES, *ALIASES, *(f"{top}.{sub}" for top, subs in SUBMODULES.items() for sub in subs.split())]

MODULES: frozenset[str] = frozenset(
    ".".join(parts[:depth]) for parts in (name.split(".") for name in _NAMED) for depth in range(1, len(parts) + 1)
)
"""Every module that can be imported: those of the tables, and the packages above them."""
