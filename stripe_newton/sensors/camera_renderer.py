# SPDX-License-Identifier: Apache-2.0
"""Camera renderer: pictures of all environments by one kernel, without a tree of bounds that follows the bodies.

Each picture lists the shapes that are in it, a height field is marched through by blocks, and what all environments
share is in the tree that Newton has built once. Rays, shading, shadows and writing are one pass.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import newton
import numpy as np
import warp as wp

from stripe_kernels.picture_light import Look
from stripe_kernels.sensors import camera_shading as shading
from stripe_kernels.sensors import camera_shapes as shapes
from stripe_kernels.sensors.ray_blocks import BLOCK, bound_blocks
from stripe_kernels.sensors.ray_field import RayField
from stripe_kernels.sensors.ray_shapes import RayTargets
from stripe_kernels.terrain import TerrainData

from .camera_slots import MESH_KINDS, CameraSlots
from .ray_caster_targets import ShapeTree, field_of

__all__ = ["CameraImages", "CameraRenderer", "visible_shapes", "why_not_rendered"]

MOST_LISTED_STATICS = 24
"""Largest number of shapes that all environments share and that each picture lists; more are met through a tree."""
_KINDS = [*MESH_KINDS, *(int(newton.GeoType[name]) for name in
          ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "CONE"))]  # fmt: skip


@dataclass
class CameraImages:
    """Images that a renderer writes, each with an empty array where it is not wanted.

    Attributes:
        color: Packed ABGR, uint32, shape ``(num_envs, height, width)``.
        plane: Depths along the optical axis [m].
        length: Distances from the camera [m].
        normals: Unit normals in the world.
        shape: Shapes, uint32.
    """

    color: wp.array
    plane: wp.array
    length: wp.array
    normals: wp.array
    shape: wp.array


def visible_shapes(model: newton.Model) -> np.ndarray:
    """Indices of the shapes that a camera may see."""
    if not model.bvh_shape_count_enabled:
        return np.zeros(0, dtype=np.int64)
    return np.sort(model.bvh_shape_enabled.numpy()[: model.bvh_shape_count_enabled].astype(np.int64))


def why_not_rendered(model: newton.Model, seen: np.ndarray, colors: bool = True) -> str:
    """Reason why pictures of a model are Newton's sensor's; empty if :class:`CameraRenderer` makes them.

    Args:
        model: The model.
        seen: Indices of the shapes that are seen.
        colors: Whether colours are among the images.
    """
    if model.particle_count:
        return "there are particles"
    sources = [model.shape_source[shape] for shape in seen] if colors else []
    if any(isinstance(s, newton.Mesh) and s.texture is not None for s in sources):
        return "a mesh has a texture"
    if getattr(model, "_has_variant_rows", False):
        return "shapes differ between environments"
    kinds = model.shape_type.numpy()[seen]
    if not np.isin(kinds, _KINDS).all():
        return f"there are shapes of type {newton.GeoType(int(kinds[~np.isin(kinds, _KINDS)][0])).name}"
    moves = (model.shape_body.numpy()[seen] >= 0) & (model.shape_world.numpy()[seen] < 0)
    return "a body that all environments share moves" if moves.any() else ""


class CameraRenderer:
    """Pictures of one camera in every environment."""

    def __init__(
        self,
        model: newton.Model,
        state: newton.State,
        lens: shapes.Lens,
        images: CameraImages,
        look: Look,
        light: shading.CameraLight,
        missing: float,
        background: int = 0,
        shadows: bool = False,
        terrain: TerrainData | None = None,
        detail: float = 0.0,
        chosen: np.ndarray | None = None,
    ):
        """Sort the shapes of a model and make the kernel.

        Args:
            model: The model, for which :func:`why_not_rendered` has no reason.
            state: The bodies, in the arrays that later pictures read.
            lens: The lens.
            images: Images to write.
            look: Air, and the size of a pixel; its light is replaced by that of each environment.
            light: Light of each environment.
            missing: Depth where there is nothing [m].
            background: Colour where there is nothing, packed ABGR; 0 for the sky.
            shadows: Whether the sun casts shadows.
            terrain: Terrain of the scene, whose memory is used if it is the height field; None without one.
            detail: Largest distance by which the surface of a mesh may move in the picture [px]; 0 to keep meshes.
            chosen: Shapes that are seen, all of them visible, bool, shape ``(shape_count,)``; None for all.
        """
        self._detail = detail
        self._model, self._state, self._lens, self._look, self._light = model, state, lens, look, light
        with wp.ScopedDevice(model.device):
            self._sort(model, terrain, chosen)
            self._smooth = self._tree_normals(model)
            self._meshes = self._slots.table.array()
            self._no_casters = wp.zeros(1, dtype=float)
        self._output(images, missing, background, shadows)

    def _sort(self, model: newton.Model, terrain: TerrainData | None, chosen: np.ndarray | None) -> None:
        """Sort shapes: those of each environment, a height field, and others that all share."""
        seen, worlds, kinds = visible_shapes(model), model.shape_world.numpy(), model.shape_type.numpy()
        everything = len(seen)
        seen = seen if chosen is None else seen[chosen[seen]]
        visible = np.zeros(model.shape_count, dtype=bool)
        visible[seen] = True
        found = field_of(model, visible & (kinds == int(newton.GeoType.HFIELD)), terrain)
        self._field_shape, self._field = found if found is not None else (-1, RayField())
        if found is None:
            self._field.heights, self._field.bounds = wp.zeros((0, 0), dtype=float), wp.zeros(2, dtype=float)
        count = [-(-(n - 1) // int(BLOCK)) if n else 0 for n in self._field.heights.shape]
        self._blocks = wp.zeros(tuple(count), dtype=wp.vec2)
        wp.launch(bound_blocks, dim=self._blocks.shape, inputs=[self._field.heights], outputs=[self._blocks])
        shared = seen[(worlds[seen] < 0) & (seen != self._field_shape)]
        self._tree = len(shared) > MOST_LISTED_STATICS
        listed = shared[:0] if self._tree else shared
        met = kinds[seen[seen != self._field_shape]]
        # Meshes of all kinds are one kind to a ray.
        self._kinds = frozenset(int(newton.GeoType.MESH) if k in MESH_KINDS else int(k) for k in np.unique(met))
        self._in_tree = shared if self._tree else shared[:0]
        self._slots = CameraSlots(model, seen[worlds[seen] >= 0], listed, self._detail)
        self._seen = self._slots.seen
        self._tree_owner = model  # of the memory that the tree is read from
        if self._tree and len(seen) < everything:  # Newton's tree has all that is visible
            mine = np.zeros(model.shape_count, dtype=bool)
            mine[shared] = True
            self._tree_owner = ShapeTree(model, mine, self._state).view
        self._statics = _tree(self._tree_owner, self._tree)

    def _tree_normals(self, model: newton.Model) -> wp.array:
        """Rows of the table of meshes that have the normals of shapes in the tree; -1 for other shapes."""
        rows, known = np.full(model.shape_count, -1, dtype=np.int32), {}
        kinds = model.shape_type.numpy()
        for shape in self._in_tree:
            source = model.shape_source[shape]
            # A hull has vertices of its own, to which the normals of its mesh do not belong.
            if not isinstance(source, newton.Mesh) or source.normals is None or kinds[shape] != MESH_KINDS[0]:
                continue
            if id(source) not in known:
                known[id(source)] = self._slots.table.as_is(0, source)
            rows[shape] = known[id(source)]
        return wp.array(rows, dtype=int)

    def _output(self, images: CameraImages, missing: float, background: int, shadows: bool) -> None:
        """Choose what is written, and the kernel for it."""
        self._out = out = shading.PictureOutput()
        for name, array in vars(images).items():
            setattr(out, name, array)
        out.background, out.missing = wp.uint32(background), missing
        wanted = {name: array.size > 0 for name, array in vars(images).items()}
        self._num_envs, self._height, self._width = next(a.shape for n, a in vars(images).items() if wanted[n])
        self.features = shading.Features(
            **wanted,
            field=self._field_shape >= 0,
            tree=self._tree,
            shadows=shadows and wanted["color"],
            kinds=self._kinds,
        )
        """Outputs of the kernel, and the kinds of things it looks at."""
        self._kernel = shading.picture_kernel(self.features)

    def variant(self, images: CameraImages, shadows: bool) -> CameraRenderer:
        """The same renderer for other images, such as to measure what each costs."""
        other = copy.copy(self)
        other._output(images, self._out.missing, int(self._out.background), shadows)
        return other

    def launch(self, due: wp.array, camera: wp.array) -> None:
        """Render; launches kernels only.

        Args:
            due: Environments that take a picture, bool, shape ``(num_envs,)``; the others keep theirs.
            camera: Poses of the cameras in the world, looking along -z [m], shape ``(num_envs,)``.
        """
        self.place(due, camera)
        self.draw(due, camera)

    def place(self, due: wp.array, camera: wp.array) -> None:
        """Find the shapes that are in each picture; arguments as of :meth:`launch`."""
        model, seen = self._model, self._seen
        inputs = [due, camera, self._lens, model.shape_transform, model.shape_body, self._state.body_q]
        inputs += [model.shape_scale, model.shape_color, self._meshes, self._detail]
        device = model.device
        wp.launch(shapes.place_shapes, dim=seen.env.shape[0], inputs=inputs, outputs=[seen], device=device)
        inputs = [due, self._width, self._height]
        wp.launch(shapes.list_shapes, dim=self._num_envs, inputs=inputs, outputs=[seen], device=device)

    def draw(self, due: wp.array, camera: wp.array) -> None:
        """Draw the shapes that :meth:`place` has found; arguments as of :meth:`launch`."""
        model = self._model
        across, down = -(-self._width // shading.TILE_WIDTH), -(-self._height // shading.TILE_HEIGHT)
        inputs = [due, wp.vec2i(across, across * down), self._width, self._height, camera, self._lens, self._seen]
        inputs += [self._field, self._blocks, self._field_shape, self._statics, model.shape_color]
        inputs += [model.shape_type, self._smooth, self._meshes, self._look, self._light, self._no_casters]
        threads = self._num_envs * across * down * shading.TILE_WIDTH * shading.TILE_HEIGHT
        wp.launch(
            self._kernel, dim=threads, inputs=inputs, outputs=[self._out], device=model.device,
            block_dim=shading.BLOCK_THREADS,
        )  # fmt: skip

    def triangles(self) -> np.ndarray:
        """Triangles of the meshes that the last pictures' lists have, shape ``(num_envs,)``; waits for the device."""
        seen = self._seen
        first, count, listed, level = (a.numpy() for a in (seen.first, seen.count, seen.listed, seen.level))
        faces = np.array([*self._slots.table.faces, 0])
        return np.array([faces[level[listed[a : a + n]]].sum() for a, n in zip(first, count, strict=False)])

    def describe(self) -> str:
        """The shapes and lists that it looks at, in a few words."""
        slots = self._seen.env.shape[0]
        parts = [f"{slots / max(self._num_envs, 1) + self._slots.merged:g} shapes in a list"]
        parts += [f"{self._slots.merged} of them part of others"] if self._slots.merged else []
        parts += ["a height field by blocks"] if self.features.field else []
        parts += ["a tree of static shapes"] if self.features.tree else []
        return ", ".join(parts)


def _tree(model: newton.Model, used: bool) -> RayTargets:
    """Newton's tree of bounds, of which the group that all environments share is read and never moves."""
    made = RayTargets()
    if not used:
        made.roots, made.kind = (wp.zeros(0, dtype=int) for _ in range(2))
        made.leaves, made.pose = wp.zeros(0, dtype=wp.uint32), wp.zeros(0, dtype=wp.transform)
        made.scale, made.source = wp.zeros(0, dtype=wp.vec3), wp.zeros(0, dtype=wp.uint64)
        return made
    made.tree, made.roots, made.leaves = model.bvh_shapes.id, model.bvh_shapes_group_roots, model.bvh_shape_enabled
    made.pose, made.kind, made.scale = model.bvh_shape_world_transforms, model.shape_type, model.shape_scale
    is_mesh = np.isin(model.shape_type.numpy(), MESH_KINDS)
    made.source = wp.array(np.where(is_mesh, model.shape_source_ptr.numpy(), 0).astype(np.uint64), dtype=wp.uint64)
    return made
