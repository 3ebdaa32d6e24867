# SPDX-License-Identifier: Apache-2.0
"""Which articulation of the model an asset config means, and its initial pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import warp as wp

from stripe_newton.configclass import ConfigError

if TYPE_CHECKING:
    import newton

    from .layout import Layout

__all__ = ["place_root", "select_layout"]


def select_layout(asset: Any, layouts: Sequence[Layout], root_path: str | None) -> Layout:
    """The one articulation at or below the asset's prim.

    Raises:
        ConfigError: if there is none, or several and ``root_path`` chooses none of them.
    """
    where = f"{type(asset).__name__} '{asset.cfg.prim_path}'"
    if not asset.in_every_env:
        raise ConfigError([f"{where}: bodies belong in environments, put it below '/World/envs/env_.*'"])
    inside = [x for x in layouts if x.path == asset.path or x.path.startswith(asset.path + "/")]
    if root_path is not None:
        inside = [x for x in inside if x.path == asset.path + root_path]
    roots = ", ".join(x.path[len(asset.path) :] or "/" for x in inside)
    if not inside:
        there = ", ".join(x.path for x in layouts) or "none"
        wanted = f"{asset.path}{root_path or ''}"
        hint = "check prim_path, and that the file applies PhysicsArticulationRootAPI"
        raise ConfigError([f"{where}: no articulation or rigid body at '{wanted}', there is {there}; {hint}"])
    if len(inside) > 1:
        hint = "choose one by articulation_root_prim_path"
        raise ConfigError([f"{where}: {len(inside)} articulations below it ({roots}); {hint}"])
    return inside[0]


def place_root(builder: newton.ModelBuilder, layout: Layout, init_state: Any) -> None:
    """Put a free root at the initial pose; a fixed one stands where it was spawned."""
    if not layout.floating:
        return
    start = layout.root_coord
    if init_state.pos is not None:
        builder.joint_q[start : start + 3] = [float(x) for x in init_state.pos]
    if init_state.rot is not None:
        builder.joint_q[start + 3 : start + 7] = [float(x) for x in init_state.rot]
    builder.body_q[layout.bodies[0]] = wp.transform(*builder.joint_q[start : start + 7])
