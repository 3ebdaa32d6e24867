# SPDX-License-Identifier: Apache-2.0
"""Terrain checks: requirements that a term has of the scene's terrain."""

from __future__ import annotations

from stripe_kernels.term_info import terrain_needs

from .context import ManagerContext

__all__ = ["check_terrain"]


def check_terrain(context: ManagerContext, where: str, func: object) -> None:
    """Add a problem if the scene's terrain lacks the flat patches or levels that a term needs."""
    terrain, needs = context.scene.terrain, terrain_needs(func)
    if needs.patches and (terrain is None or needs.patches not in terrain.flat_patches):
        text = f"the scene's terrain has no flat patches named '{needs.patches}'"
        context.problems.append(f"{where}: {text}; set flat_patch_sampling of its sub-terrains")
    generator = None if terrain is None else terrain.generator
    if needs.curriculum and generator is not None and not generator.cfg.curriculum:
        context.problems.append(
            f"{where}: the terrain's levels do not get harder; set curriculum=True in its generator"
        )
