# SPDX-License-Identifier: Apache-2.0
"""Ray targets: what the rays of a sensor may hit, a height field that is read directly and shapes in a tree."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Sequence

import newton
import numpy as np
import warp as wp

from stripe_kernels.sensors.ray_field import RayField
from stripe_kernels.sensors.ray_shapes import RayTargets
from stripe_kernels.terrain import TerrainData
from stripe_newton.configclass import ConfigError
from stripe_newton.expressions import expression_of, full_match, reason_of
from stripe_newton.sim.scene_context import ENV_0

__all__ = ["ShapeTree", "choose_shapes", "choose_visible", "field_of", "path_problems"]

_FAR = 1.0e6
"""Half the extent of the height field that replaces an infinite plane [m]."""
_CHOSEN = 1 << 30
"""Bit of the shape flags that marks the shapes of a tree, beyond those that Newton uses."""


def choose_shapes(model: newton.Model, expressions: Sequence[str], own: str, where: str) -> np.ndarray:
    """Choose the colliders that the rays hit.

    Args:
        model: The model.
        expressions: Prim paths; empty for all.
        own: Path of an asset that is left out; empty for none.
        where: The sensor, for errors.

    Returns:
        bool, shape ``(shape_count,)``.

    Raises:
        ConfigError: if an expression matches no collider, or none is left.
    """
    collides = (model.shape_flags.numpy() & int(newton.ShapeFlags.COLLIDE_SHAPES)) != 0
    paths = _paths(model)
    chosen = _named_shapes(model, expressions, collides, "collider", where) if len(expressions) else collides.copy()
    # After the paths were checked: a path that names the robot's own parts is no mistake, they are passed through.
    if own:
        chosen &= ~_matching(paths, re.escape(own))
    if not chosen.any():
        why = f"all of them belong to '{own}', which carries it" if own and collides.any() else "there is none"
        raise ConfigError([f"{where}: no collider for its rays to hit, {why}; name some by mesh_prim_paths"])
    return chosen


def choose_visible(model: newton.Model, expressions: Sequence[str], visible: np.ndarray, where: str) -> np.ndarray:
    """Choose the shapes that a camera sees.

    Args:
        model: The model.
        expressions: Prim paths, at least one.
        visible: Visible shapes, bool, shape ``(shape_count,)``.
        where: The sensor, for errors.

    Returns:
        bool, shape ``(shape_count,)``.

    Raises:
        ConfigError: if an expression matches no visible shape.
    """
    return _named_shapes(model, expressions, visible, "visible shape", where)


def _named_shapes(
    model: newton.Model, expressions: Sequence[str], among: np.ndarray, kind: str, where: str
) -> np.ndarray:
    """Shapes at or below some prims.

    Args:
        model: The model.
        expressions: Prim paths. A body may be named right below its asset, wherever its file has it.
        among: Shapes that count, bool, shape ``(shape_count,)``.
        kind: What these are, for errors.
        where: The sensor, for errors.

    Raises:
        ConfigError: if an expression matches none.
    """
    paths, short = _paths(model), _paths_of_bodies(model)
    chosen, problems = np.zeros(len(paths), dtype=bool), list[str]()
    for i, text in enumerate(expressions):
        pattern = text.replace("{ENV_REGEX_NS}", ENV_0).replace("/World/envs/env_.*", ENV_0)
        hits = (_matching(paths, pattern.rstrip("/")) | _matching(short, pattern.rstrip("/"))) & among
        chosen |= hits
        if not hits.any():
            there = sorted({_short(p) for p, c in zip(paths, among, strict=True) if c})
            names = ", ".join(there) or "none"
            problems.append(f"{where}.mesh_prim_paths[{i}]: no {kind} at or below '{text}'; there is {names}")
    if problems:
        raise ConfigError(problems)
    return chosen


def path_problems(paths: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Problems of the field ``mesh_prim_paths``, as a config reports them."""
    if isinstance(paths, str):
        yield "mesh_prim_paths", f"is {paths!r}, must be a sequence: [{paths!r}]"
        return
    for i, path in enumerate(paths):
        try:
            expression_of(path)
        except re.error as error:
            yield f"mesh_prim_paths[{i}]", f"is {path!r}, which {reason_of(error)}"


def _paths(model: newton.Model) -> list[str]:
    """Path of each shape, below that of its body."""
    bodies = model.shape_body.numpy()
    return [_path(model, i, int(bodies[i])) for i in range(model.shape_count)]


def _paths_of_bodies(model: newton.Model) -> list[str]:
    """Path of each shape's body right below its asset, as in files whose bodies do not lie in each other; empty for
    shapes without a body."""
    bodies = [str(label) for label in model.body_label]
    flat = [f"{_short(label).replace('{ENV_REGEX_NS}', ENV_0)}/{label.rpartition('/')[2]}" for label in bodies]
    return [flat[body] if body >= 0 else "" for body in model.shape_body.numpy()]


def _path(model: newton.Model, shape: int, body: int) -> str:
    """Path of a shape, below that of its body."""
    label = str(model.shape_label[shape])
    owner = str(model.body_label[body]) if body >= 0 else ""
    return label if label.startswith(owner) else f"{owner}/{label}"


def _matching(paths: list[str], pattern: str) -> np.ndarray:
    """Paths at or below what a pattern matches, bool, one for each path."""
    seen: dict[str, bool] = {}  # the same paths come again in every environment
    for path in paths:
        if path not in seen:
            try:
                seen[path] = full_match(f"{pattern}(/.*)?", path) is not None
            except re.error as error:
                raise ConfigError([f"mesh_prim_paths: '{pattern}' {reason_of(error)}"]) from None
    return np.array([seen[path] for path in paths], dtype=bool)


def _short(path: str) -> str:
    """Path of the asset that a shape belongs to."""
    depth = 5 if path.startswith(ENV_0) else 3
    return "/".join(path.split("/")[:depth]).replace(ENV_0, "{ENV_REGEX_NS}")


def field_of(model: newton.Model, chosen: np.ndarray, terrain: TerrainData | None) -> tuple[int, RayField] | None:
    """The height field among the chosen shapes that rays look up directly.

    It is the only one, is shared by all environments and stands upright along the world's axes. If there is none, the
    only shared level plane without end is a field of one cell.

    Args:
        model: The model.
        chosen: Shapes, bool, shape ``(shape_count,)``.
        terrain: Terrain of the scene, whose memory is used if it is that field; None without one.

    Returns:
        The shape's index and the field, or None if there is no such field.
    """
    kinds, shared = model.shape_type.numpy(), (model.shape_body.numpy() < 0) & (model.shape_world.numpy() < 0)
    fields = np.flatnonzero(chosen & (kinds == int(newton.GeoType.HFIELD)))
    if not len(fields):
        return _plane_field(model, np.flatnonzero(chosen & (kinds == int(newton.GeoType.PLANE))), shared)
    if len(fields) != 1 or not shared[fields[0]]:
        return None
    shape = int(fields[0])
    source, scale = model.shape_source[shape], model.shape_scale.numpy()[shape]
    pose = model.shape_transform.numpy()[shape]
    # Upright along the axes of the world: a field that is turned is met as a mesh.
    if not np.allclose(np.abs(pose[3:]), (0.0, 0.0, 0.0, 1.0), atol=1.0e-6):
        return None
    half = np.array([source.hx, source.hy]) * scale[:2]
    heights = (source.min_z + source.data * (source.max_z - source.min_z)) * scale[2] + pose[2]
    field = RayField()
    lower, cell = pose[:2] - half, 2.0 * half / (source.ncol - 1, source.nrow - 1)
    field.lower, field.cell = wp.vec2(*map(float, lower)), wp.vec2(*map(float, cell))
    bounds = [float(heights.min()), float(heights.max())]
    field.bounds = wp.array(bounds, dtype=float, device=model.device)
    if terrain is not None and _is_same(terrain, heights, lower, cell):
        field.heights = terrain.heights
    else:
        field.heights = wp.array(heights.astype(np.float32), dtype=float, device=model.device)
    return shape, field


def _is_same(terrain: TerrainData, heights: np.ndarray, lower: np.ndarray, cell: np.ndarray) -> bool:
    """Whether a terrain has the heights of a field, on the same grid."""
    return (
        tuple(terrain.heights.shape) == heights.shape
        and np.allclose([*terrain.lower, *terrain.cell], [*lower, *cell], rtol=1.0e-5, atol=1.0e-5)
        and np.allclose(terrain.heights.numpy(), heights, atol=1.0e-4)
    )


def _plane_field(model: newton.Model, planes: np.ndarray, shared: np.ndarray) -> tuple[int, RayField] | None:
    """A level plane as a field of one cell."""
    if len(planes) != 1 or not shared[planes[0]]:
        return None
    shape = int(planes[0])
    pose, scale = model.shape_transform.numpy()[shape], model.shape_scale.numpy()[shape]
    up = wp.quat_rotate(wp.quat(*map(float, pose[3:])), wp.vec3(0.0, 0.0, 1.0))
    # A plane with a width and a length ends, and a tilted one has no height field.
    if scale[:2].any() or not up[2] > 1.0 - 1.0e-7:
        return None
    field, height = RayField(), float(pose[2])
    field.lower, field.cell = wp.vec2(-_FAR, -_FAR), wp.vec2(2.0 * _FAR, 2.0 * _FAR)
    field.bounds = wp.full(2, value=height, dtype=float, device=model.device)
    field.heights = wp.full((2, 2), value=height, dtype=float, device=model.device)
    return shape, field


class ShapeTree:
    """Some shapes of a model in a tree of bounding volumes, made and refitted by Newton.

    Attributes:
        view: The model with this tree in place of the one of all its visible shapes.
        moves: Whether a body carries one of the shapes, so that :meth:`refit` is needed.
    """

    def __init__(self, model: newton.Model, chosen: np.ndarray, state: newton.State):
        """Build the tree.

        Args:
            model: The model.
            chosen: The shapes, bool, shape ``(shape_count,)``.
            state: Where the bodies are now.
        """
        # A shallow copy: it shares every array with the model but has a tree and flags of its own.
        self.view = copy.copy(model)
        flags = np.where(chosen, model.shape_flags.numpy() | _CHOSEN, model.shape_flags.numpy() & ~_CHOSEN)
        self.view.shape_flags = wp.array(flags.astype(np.int32), dtype=int, device=model.device)
        self.view.bvh_build_shapes(state, shape_flags=_CHOSEN)
        self.moves = bool((model.shape_body.numpy()[chosen] >= 0).any())

    def refit(self, state: newton.State) -> None:
        """Follow the bodies; launches kernels only."""
        if self.moves:
            self.view.bvh_refit_shapes(state)

    def targets(self) -> RayTargets:
        """The struct that ``stripe_kernels.sensors.ray_shapes`` reads."""
        view, made = self.view, RayTargets()
        made.tree, made.roots, made.leaves = view.bvh_shapes.id, view.bvh_shapes_group_roots, view.bvh_shape_enabled
        made.pose, made.kind, made.scale = view.bvh_shape_world_transforms, view.shape_type, view.shape_scale
        made.source = view.shape_source_ptr
        return made
