# SPDX-License-Identifier: Apache-2.0
"""Sensor mount: the body or site that a ray caster or a camera is fixed to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.sim.scene_context import ENV_0, authored_path

from .prim_paths import Frame, find_frames

if TYPE_CHECKING:
    from stripe_newton.assets.scene_assets import SceneAssets

__all__ = ["carrying_asset", "find_mount"]


def find_mount(template: newton.ModelBuilder, prim_path: str, where: str, own_prim: bool = False) -> Frame:
    """The one body or site that ``prim_path`` names.

    Args:
        template: One environment.
        prim_path: The path.
        where: The sensor, for errors.
        own_prim: Whether the last part may be a new name for the sensor, below a body or the environment.

    Raises:
        ConfigError: if there is none, or several.
    """
    try:
        frames = find_frames(template, prim_path, f"{where}.prim_path")
    except ConfigError:
        if not own_prim:
            raise
        parent, _, name = prim_path.rpartition("/")
        if authored_path(parent) == ENV_0:
            return Frame(name, -1, wp.transform_identity())
        frames = find_frames(template, parent, f"{where}.prim_path")
    if len(frames) > 1:
        names = ", ".join(frame.name for frame in frames)
        raise ConfigError([f"{where}.prim_path: {names} match, it must name one body"])
    return frames[0]


def carrying_asset(scene: SceneAssets, template: newton.ModelBuilder, body: int) -> str:
    """Path of the asset that a body belongs to; empty for none."""
    if body < 0:
        return ""
    label = str(template.body_label[body])
    paths = [a.path for a in scene.assets if label == a.path or label.startswith(a.path + "/")]
    return str(max(paths, key=len, default=label))
