# SPDX-License-Identifier: Apache-2.0
"""Display model: a small model for drawing, with the static scene and copies of a few environments in one world."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import newton
import numpy as np
import warp as wp

from stripe_kernels.picture import gather_bodies
from stripe_newton.shape_mesh import shape_mesh
from stripe_newton.sim.body_choice import BodyChoice
from stripe_newton.usd.textures import drop_unreadable_textures

from .creases import crease_builder
from .marker_slots import MarkerSlots
from .recolor import recolor_shapes
from .sight_line import SightLine
from .surround import add_surround
from .viewed_simulation import ViewedSimulation

__all__ = ["DisplayModel"]

_ROUND_TYPES = (newton.GeoType.SPHERE, newton.GeoType.CAPSULE, newton.GeoType.CYLINDER)
_COLLIDE = int(newton.ShapeFlags.COLLIDE_SHAPES) | int(newton.ShapeFlags.COLLIDE_PARTICLES)
_GROUND_TYPES = (int(newton.GeoType.PLANE), int(newton.GeoType.HFIELD))
_WALL_TYPES = (int(newton.GeoType.BOX), int(newton.GeoType.MESH), int(newton.GeoType.CONVEX_MESH))
_NATURAL_MESHES = 64
"""Number of static meshes from which a scene counts as outdoors."""


class DisplayModel:
    """Copies of chosen environments of a simulation in one world, in their current pose.

    Attributes:
        model: The display model, on the simulation's device.
        state: Its state, set by :meth:`update`.
        roots: Index in the display state of each copy's first body, shape (number of copies,).
        colors: Linear RGB of each shape, shape (shape_count, 3).
        kinds: ``GeoType`` of each shape, shape (shape_count,).
        is_ground: Whether each shape is a plane or height field, shape (shape_count,).
        is_visible: Whether each shape is drawn by Newton's sensor, shape (shape_count,).
        textured: Whether a shape carries a texture.
        has_markers: Whether there are markers.
        scenery: Shapes that :class:`SceneryTracer` traces instead of Newton's sensor, shape (n,).

    Args:
        sim: The simulation.
        env_ids: Which environments to copy.
        floor: Add a floor below everything if nothing static is there and nothing falls.
        recolor: Replace colours that the stage did not author.
        natural: Leave static meshes to :class:`SceneryTracer`. None: if there are 64 of them or more.
        is_traced: Prepare for rays and put markers in. Without, only shapes and poses are of use.
        horizon: Continue a height field to the horizon.

    Raises:
        IndexError: An environment that the simulation does not have.
    """

    def __init__(
        self,
        sim: ViewedSimulation,
        env_ids: Sequence[int],
        floor: bool = False,
        recolor: bool = True,
        natural: bool | None = None,
        is_traced: bool = True,
        horizon: bool = False,
    ):
        env_ids = [int(i) for i in env_ids]
        wrong = [i for i in env_ids if not 0 <= i < sim.num_envs]
        if wrong or not env_ids:
            raise IndexError(f"env_ids: got {wrong or env_ids}, expected some of 0 to {sim.num_envs - 1}")
        self._sim = sim
        template, static = sim.template, sim.static
        for each in (static, template):  # the import looked at headers and ends alone
            for path, _, why in drop_unreadable_textures(each, 0, whole=True):
                warnings.warn(f"{path}: texture: {why}", stacklevel=3)
        builder = newton.ModelBuilder()
        builder.begin_world()
        builder.add_builder(static)
        self._static_shapes, self._first_body = builder.shape_count, builder.body_count
        for i in env_ids:
            origin = wp.vec3(*(float(x) for x in sim.env_origins[i]))
            first = builder.shape_count, builder.body_count
            builder.add_builder(template, xform=wp.transform(origin, wp.quat_identity()))
            _put_choices(builder, sim.body_choices, i, *first)
        self._index_bodies(builder, env_ids)
        if floor and _may_have_floor(static, template):
            # Under the lowest point of the current poses, and a little lower so that no surface flickers.
            heights = self._corners(self._pose(sim))[..., 2]
            builder.add_ground_plane(height=float(heights.min(initial=0.0, where=np.isfinite(heights))) - 1e-3)
        if recolor:
            recolor_shapes(builder, self._static_shapes, self._first_body, template)
        surround = add_surround(builder, self._static_shapes) if horizon else None
        self._prepare_shapes(builder, template, natural, surround)
        self._is_traced = is_traced
        self._markers = MarkerSlots(builder, sim, env_ids, is_traced)
        builder.end_world()
        self.sources = list(builder.shape_source)
        self.kinds = np.asarray(builder.shape_type, dtype=int)
        self.is_ground = np.isin(self.kinds, _GROUND_TYPES)
        self.is_visible = (np.asarray(builder.shape_flags, dtype=int) & int(newton.ShapeFlags.VISIBLE)) != 0
        self.has_markers = self._markers.first_body < builder.body_count
        if surround is not None:
            self.is_ground[surround] = True
        self.colors = np.array([newton.utils.color_srgb_to_linear(c) for c in builder.shape_color]).reshape(-1, 3)
        self.textured = any(getattr(s, "texture", None) is not None for s in builder.shape_source)
        if not is_traced:
            _leave_out_meshes(builder)
        self.model = builder.finalize(device=sim.device, skip_all_validations=True)
        self.state = self.model.state()
        self.body_q = np.zeros((0, 7))
        self.update()

    def _index_bodies(self, builder: newton.ModelBuilder, env_ids: Sequence[int]) -> None:
        """Keep which bodies and shapes of the builder are whose, before a floor is added to it."""
        self.body_count = count = self._sim.template.body_count
        index = np.concatenate([np.arange(i * count, (i + 1) * count) for i in env_ids])
        self._index = wp.array(index, dtype=wp.int32, device=self._sim.device)
        self.roots = self._first_body + count * np.arange(len(env_ids))
        self._local = _local_bounds(builder)
        self._shape_body = np.asarray(builder.shape_body, dtype=int)
        self._shape_xform = np.asarray([list(x) for x in builder.shape_transform], dtype=float).reshape(-1, 7)
        # The last element is for shapes on no body, whose body is -1: the world, which does not move.
        self._moves = np.append(np.tile(~_welded_to_world(self._sim.template), len(env_ids)), False)
        if self._first_body:
            self._moves = np.concatenate([np.zeros(self._first_body, dtype=bool), self._moves])

    def _prepare_shapes(
        self, builder: newton.ModelBuilder, template: newton.ModelBuilder, natural: bool | None, surround: int | None
    ) -> None:
        """Adapt the shapes to drawing: no collisions, no coinciding surfaces, scenery hidden from the sensor."""
        if self.body_count:
            _separate_surfaces(builder, self._static_shapes, self._first_body, self.body_count)
        # Nothing collides in a model that is only looked at, and finalize() would pair all its shapes.
        builder.shape_flags = [int(f) & ~_COLLIDE for f in builder.shape_flags]
        if template.shape_count:
            _keep_one_ground(builder, self._static_shapes, template.shape_count)
        self.scenery = _scenery(builder, self._static_shapes, natural)
        if surround is not None and len(self.scenery):
            self.scenery = np.append(self.scenery, surround)
        for i in self.scenery:
            builder.shape_flags[i] &= ~int(newton.ShapeFlags.VISIBLE)
        crease_builder(builder)  # after scenery was hidden: it is drawn by its faces

    def update(self) -> np.ndarray:
        """Copy the body poses of the simulation and refit the hierarchy that rays are traced against.

        Returns:
            Poses of display bodies without markers, on the host, (x, y, z, qx, qy, qz, qw), shape (bodies, 7).
        """
        self._markers.update(self.model, self.state)
        if self.body_count:
            out = self.state.body_q[self._first_body : self._markers.first_body]
            args = [self._sim.state.body_q, self._index, out]
            wp.launch(gather_bodies, dim=len(self._index), inputs=args, device=self.model.device)
            self.body_q = self.state.body_q.numpy()[: self._markers.first_body]
        # A refit keeps the tree of the hierarchy and costs far less than a new one.
        if self._is_traced and self.model.shape_count and self.model.bvh_shape_count_enabled:
            self.model.bvh_refit_shapes(self.state)
        return self.body_q

    def sight_line(self) -> SightLine:
        """The visible meshes and boxes that do not move, which may be between a camera and what it looks at."""
        line, scales = SightLine(), self.model.shape_scale.numpy()
        for shape in np.flatnonzero((self._shape_body < 0) & self.is_visible[: len(self._shape_body)]):
            if self.kinds[shape] in _WALL_TYPES:
                kind = newton.GeoType.BOX if self.kinds[shape] == newton.GeoType.BOX else newton.GeoType.MESH
                mesh = shape_mesh(kind, scales[shape], self.sources[shape], self.model.shape_label[shape])
                line.add(*mesh, np.ones((1, 3)), self._shape_xform[shape][None])
        return line

    def has_all_markers(self) -> bool:
        """Whether there is room for the markers of the simulation; if not, a new display model is needed."""
        return self._markers.fit()

    def corners(self) -> np.ndarray:
        """Corners of the box around each shape, without markers and an added floor [m], as of the last :meth:`update`.

        Returns:
            Points in the world frame, shape (shapes, 8, 3); not finite for shapes that are hidden or have no end.
        """
        return self._corners(self.body_q)

    def bounds(self, copy: int | None = None) -> np.ndarray:
        """Corners of the boxes around everything that a picture should show [m].

        These are the shapes that can move and the parts of fixed ones (a rail, a base) near them. If nothing can move,
        they are all shapes of the environment except its ground.

        Args:
            copy: Only what moves in this copy, and what is near. None: in all of them.

        Returns:
            Points in the world frame, shape (n, 3).
        """
        corners = self._corners(self.body_q)
        shown = np.isfinite(corners).all(axis=(1, 2))
        own = shown & (np.arange(len(shown)) >= self._static_shapes)
        moves = own & self._moves[self._shape_body]  # a shape of the world has body -1: the last element
        moving = moves
        if copy is not None:
            first = self.roots[copy]
            moving = moves & (self._shape_body >= first) & (self._shape_body < first + self.body_count)
        if not moving.any():
            return corners[own if own.any() else shown].reshape(-1, 3)
        points = corners[moving].reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        # A long rail or a wide table would make the robot small: of fixed shapes only what is near counts.
        around = 1.3 * float((high - low).max())
        held = corners[own & ~moves]
        near = ((held.max(axis=1) >= low - around) & (held.min(axis=1) <= high + around)).all(axis=1)
        return np.concatenate([points, np.clip(held[near], low - around, high + around).reshape(-1, 3)])

    def _pose(self, sim: ViewedSimulation) -> np.ndarray:
        """Poses of the copies' bodies, for use before there is a display model."""
        if not self.body_count:
            return np.zeros((0, 7))
        return np.concatenate([np.zeros((self._first_body, 7)), sim.state.body_q.numpy()[self._index.numpy()]])

    def _corners(self, body_q: np.ndarray) -> np.ndarray:
        """Corners of each shape's box in the world frame [m], shape (shapes, 8, 3); not finite for hidden shapes."""
        pick = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
        corners = np.where(pick[None], self._local[:, None, 1], self._local[:, None, 0])
        with np.errstate(invalid="ignore"):
            corners = _transform(self._shape_xform[:, None], corners)
            on_body = self._shape_body >= 0
            if on_body.any():
                corners[on_body] = _transform(body_q[self._shape_body[on_body]][:, None], corners[on_body])
        return corners


def _leave_out_meshes(builder: newton.ModelBuilder) -> None:
    """Make boxes of all meshes and height fields: their trees for rays take seconds, and nobody traces any."""
    for i, source in enumerate(builder.shape_source):
        if source is not None:
            builder.shape_type[i], builder.shape_source[i] = newton.GeoType.BOX, None


def _put_choices(
    builder: newton.ModelBuilder, choices: Sequence[BodyChoice], env: int, first_shape: int, first_body: int
) -> None:
    """Draw the assets that an environment has, in a copy of the template."""
    for choice in choices:
        choice.write(builder, env, first_shape, first_body)
        for row in choice.absent(env):
            builder.shape_flags[first_shape + row] &= ~int(newton.ShapeFlags.VISIBLE)


def _scenery(builder: newton.ModelBuilder, count: int, natural: bool | None) -> np.ndarray:
    """Visible meshes and height fields without texture among the first ``count`` shapes, the static scene."""
    kinds = (int(newton.GeoType.MESH), int(newton.GeoType.HFIELD))
    visible = int(newton.ShapeFlags.VISIBLE)
    found = [
        i
        for i in range(count)
        if int(builder.shape_type[i]) in kinds
        and int(builder.shape_body[i]) < 0
        and int(builder.shape_flags[i]) & visible
        and getattr(builder.shape_source[i], "texture", None) is None
    ]
    # Height fields alone make no scene outdoors: a training terrain has one.
    meshes = sum(int(builder.shape_type[i]) == kinds[0] for i in found)
    return np.array(found if (meshes >= _NATURAL_MESHES if natural is None else natural) else [], dtype=int)


def _may_have_floor(static: newton.ModelBuilder, template: newton.ModelBuilder) -> bool:
    """Whether a floor below everything misleads nobody: nothing static is there to stand on, and nothing falls."""
    if static.shape_count or any(int(t) in _GROUND_TYPES for t in template.shape_type):
        return False
    stands = any(b < 0 and f & _COLLIDE for b, f in zip(template.shape_body, template.shape_flags, strict=True))
    return not stands and int(newton.JointType.FREE) not in map(int, template.joint_type)


def _separate_surfaces(builder: newton.ModelBuilder, first_shape: int, first_body: int, bodies: int) -> None:
    """Make round shapes thinner by up to half a percent, by a different amount for each body.

    Capsules that meet in a joint share a surface there: rays would hit either of them at random.
    """
    for i in range(first_shape, builder.shape_count):
        body = int(builder.shape_body[i])
        if body >= first_body and builder.shape_type[i] in _ROUND_TYPES:
            radius, *rest = (float(x) for x in builder.shape_scale[i])
            builder.shape_scale[i] = (radius * (1.0 - 0.001 * ((body - first_body) % bodies % 6)), *rest)


def _keep_one_ground(builder: newton.ModelBuilder, first: int, count: int) -> None:
    """Hide infinite planes that coincide with one of the first copy, shapes ``first`` to ``first + count``.

    Each plane slows every ray, and coinciding planes flicker.
    """
    for i in range(first + count, builder.shape_count):
        endless = int(builder.shape_type[i]) == int(newton.GeoType.PLANE) and not any(builder.shape_scale[i][:2])
        if endless and int(builder.shape_body[i]) < 0:
            mine, its = (_plane(builder.shape_transform[k]) for k in (i, first + (i - first) % count))
            if np.abs(mine - its).max() < 1e-4:
                builder.shape_flags[i] &= ~int(newton.ShapeFlags.VISIBLE)


def _plane(xform: wp.transform) -> np.ndarray:
    """Normal and offset [m] of the plane z = 0 of a frame, shape (4,)."""
    pose = np.asarray(list(xform), dtype=float)
    normal = _transform(pose, np.array([0.0, 0.0, 1.0])) - pose[:3]
    return np.append(normal, normal @ pose[:3])


def _transform(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) transformed by poses (..., 7)."""
    xyz, w = pose[..., 3:6], pose[..., 6:7]  # quaternion: v + 2 w (q x v) + 2 q x (q x v)
    cross = 2.0 * np.cross(xyz, points)
    return points + w * cross + np.cross(xyz, cross) + pose[..., :3]


def _local_bounds(builder: newton.ModelBuilder) -> np.ndarray:
    """Lower and upper corner of each shape in its own frame, shape (shapes, 2, 3); infinite if hidden or a ground."""
    kinds = newton.GeoType
    bounds, known = np.full((builder.shape_count, 2, 3), np.inf), dict[int, np.ndarray]()
    for i, (kind, scale, source) in enumerate(zip(builder.shape_type, builder.shape_scale, builder.shape_source)):
        if not int(builder.shape_flags[i]) & int(newton.ShapeFlags.VISIBLE) or int(kind) in _GROUND_TYPES:
            continue
        a, b, c = (float(s) for s in scale)
        vertices = getattr(source, "vertices", None)
        if vertices is not None and len(vertices):
            if id(source) not in known:  # thousands of shapes may share one mesh
                points = np.asarray(vertices, dtype=float)
                known[id(source)] = np.stack([points.min(axis=0), points.max(axis=0)])
            # A negative scale swaps the corners.
            bounds[i] = np.sort(known[id(source)] * (a, b, c), axis=0)
            continue
        # The meaning of the scale's values depends on the type, see newton.GeoType; a box has half extents.
        half = {
            kinds.SPHERE: (a, a, a),
            kinds.CAPSULE: (a, a, a + b),
            kinds.CYLINDER: (a, a, b),
            kinds.CONE: (a, a, b),
        }.get(kind, (a, b, c))
        bounds[i] = -np.asarray(half), np.asarray(half)
    return bounds


def _welded_to_world(template: newton.ModelBuilder) -> np.ndarray:
    """Whether only fixed joints connect a body to the world, shape (body_count,)."""
    welded = np.zeros(template.body_count, dtype=bool)
    fixed = int(newton.JointType.FIXED)
    joints = [
        (int(p), int(c))
        for k, p, c in zip(template.joint_type, template.joint_parent, template.joint_child)
        if int(k) == fixed
    ]
    for _ in joints:  # joints come in any order: each round reaches one body further
        for parent, child in joints:
            welded[child] |= parent < 0 or welded[parent]
    return welded
