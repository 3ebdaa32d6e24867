# SPDX-License-Identifier: Apache-2.0
"""Terrain checks: whether the scene's ground has what a term about it needs."""

from __future__ import annotations

from stripe_kernels.term_info import terrain_needs

from .context import ManagerContext

__all__ = ["check_terrain"]


def check_terrain(context: ManagerContext, where: str, func: object) -> None:
    """Note a problem if the scene's ground lacks what a term works on."""
    terrain, needs = context.scene.terrain, terrain_needs(func)
    if needs.patches and needs.patches not in getattr(terrain, "flat_patches", {}):
        text = f"the scene's terrain has no level patches named '{needs.patches}'; ask for them by flat_patch_sampling"
        context.problems.append(f"{where}: {text}")
    generator = getattr(terrain, "generator", None)
    if needs.curriculum and generator is not None and not generator.cfg.curriculum:
        context.problems.append(
            f"{where}: the terrain's levels do not get harder; set curriculum=True in its generator"
        )
