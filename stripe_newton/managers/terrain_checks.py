# SPDX-License-Identifier: Apache-2.0
"""What terms about the ground need of it."""

from __future__ import annotations

from typing import Any

from stripe_kernels import mdp

from .context import ManagerContext

__all__ = ["check_terrain"]

_PATCHES = {
    mdp.reset_root_state_from_terrain: "init_pos",
    mdp.resample_terrain_based_pose_2d: "target",
}
"""Patches that terms choose from."""


def check_terrain(context: ManagerContext, where: str, func: Any) -> None:
    """Note a problem if the scene's ground lacks what a term works on."""
    terrain = context.scene.terrain
    patches = _PATCHES.get(func)
    if patches is not None and patches not in getattr(terrain, "flat_patches", {}):
        text = f"the scene's terrain has no level patches named '{patches}'; ask for them by flat_patch_sampling"
        context.problems.append(f"{where}: {text}")
    generator = getattr(terrain, "generator", None)
    if func is mdp.terrain_levels_vel and generator is not None and not generator.cfg.curriculum:
        context.problems.append(
            f"{where}: the terrain's levels do not get harder; set curriculum=True in its generator"
        )
