# SPDX-License-Identifier: Apache-2.0
"""Live scene: the shapes of some environments as instanced meshes in a browser, moved at each picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import newton
import numpy as np

from stripe_newton.shape_mesh import shape_mesh
from stripe_newton.viewers.display_model import DisplayModel
from stripe_newton.viewers.poses import compose, wxyz
from stripe_newton.viewers.sight_line import SightLine
from stripe_newton.viewers.viewed_simulation import ViewedSimulation

from .closed_mesh import is_closed
from .glb_file import glb_of
from .merged_field import merged_field
from .scenery_files import foliage_file, ground_file, has_colors
from .view_frame import VIEW, WORLD, ViewFrame

if TYPE_CHECKING:
    import viser

__all__ = ["LiveScene", "ShapeBatch", "linear_bytes"]

_FACETS_OFF = 0.002
"""Distance of the facets of round shapes from their surface in radii: coarser than for contacts, for the browser."""
_ROUND = tuple(map(int, (newton.GeoType.SPHERE, newton.GeoType.CAPSULE, newton.GeoType.CYLINDER)))
_THINNER = 0.008
"""Share by which round shapes get thinner from body to body: surfaces that meet in a joint would flicker."""
_UNIT = {newton.GeoType.SPHERE: (0, 0, 0), newton.GeoType.BOX: (0, 1, 2), newton.GeoType.ELLIPSOID: (0, 1, 2)}
"""Shapes that are one mesh in all sizes, with the sizes along x, y and z."""
_FIELD_TOLERANCE, _GROUND_TOLERANCE = 1.0e-3, 0.025
"""Largest errors of height fields and of those outdoors, which would be tens of megabytes otherwise [m]."""
_MOST_FIXED = 512
"""Instances of fixed shapes that are sent whenever the camera moves; more of them are below the node of the world."""
_AWAY = (0.0, 0.0, -1.0e4)
"""Where shapes are put whose pose is not finite [m]."""


@dataclass
class ShapeBatch:
    """Instances of one mesh."""

    handle: viser.BatchedMeshHandle | viser.BatchedGlbHandle
    """The instances in the browser."""
    bodies: np.ndarray
    """Body of each instance in the display model; -1 for the world, shape ``(n,)``."""
    local: np.ndarray
    """Poses on the bodies, shape ``(n, 7)``."""
    is_in_view: bool
    """Whether their poses are in the scene that browsers show, rather than in the world."""

    @property
    def moves(self) -> bool:
        """Whether a body of the simulation moves any of them."""
        return bool((self.bodies >= 0).any())


class _Placed:
    """Batches that are placed together: a robot of many parts is many batches."""

    def __init__(self, batches: list[ShapeBatch]):
        self._batches = batches
        self._bodies = np.concatenate([np.zeros(0, dtype=int), *(batch.bodies for batch in batches)])
        self._local = np.concatenate([np.zeros((0, 7)), *(batch.local for batch in batches)])

    def place(self, body_q: np.ndarray, frame: ViewFrame) -> None:
        """Send the poses of all instances in the scene."""
        if not self._batches:
            return
        poses = frame.poses(_world_poses(body_q, self._bodies, self._local))
        turns, places, begin = wxyz(poses[:, 3:]), poses[:, :3].astype(np.float32), 0
        for batch in self._batches:
            end = begin + len(batch.bodies)
            batch.handle.batched_positions, batch.handle.batched_wxyzs = places[begin:end], turns[begin:end]
            begin = end


class LiveScene:
    """Shapes of chosen environments in the browser.

    Args:
        server: The web server.
        sim: The simulation.
        env_ids: The environments, each at its origin.

    Raises:
        IndexError: An environment that the simulation does not have.
    """

    def __init__(self, server: viser.ViserServer, sim: ViewedSimulation, env_ids: Sequence[int]):
        self._server, self._sim = server, sim
        self.env_ids = [int(i) for i in env_ids]
        self.model = DisplayModel(sim, env_ids, is_traced=False)
        self.batches: list[ShapeBatch] = []
        self.grounds: list[np.ndarray] = []
        """Poses of endless planes, which are left to the backdrop."""
        self.sight_line = SightLine()
        """Things that do not move and may be between a camera and its target."""
        self._add_batches()
        self._moving = _Placed([batch for batch in self.batches if batch.moves])
        self._fixed = _Placed([batch for batch in self.batches if not batch.moves and batch.is_in_view])
        self._fixed_at: tuple[float, ...] | None = None
        """Where the world was when fixed shapes were last placed."""

    @property
    def body_q(self) -> np.ndarray:
        """Poses of the display model's bodies at the last update, shape ``(bodies, 7)``."""
        return self.model.body_q

    def body_of(self, display_body: int) -> tuple[int, int]:
        """Environment, and body in its template, of a body of the display model; (-1, -1) for a static one."""
        first = int(self.model.roots[0]) if len(self.model.roots) else 0
        if display_body < first or not self.model.body_count:
            return -1, -1
        copy, body = divmod(display_body - first, self.model.body_count)
        return self.env_ids[copy], body

    def root_of(self, env_id: int) -> int | None:
        """First body of an environment in the display model; None if it is not shown or has no bodies."""
        if env_id not in self.env_ids or not self.model.body_count:
            return None
        return int(self.model.roots[self.env_ids.index(env_id)])

    def read(self) -> None:
        """Read the poses of the simulation, for the camera and then for :meth:`place`."""
        self.model.update()

    def place(self, frame: ViewFrame) -> None:
        """Move all shapes to where they were last read.

        Args:
            frame: Where the world is in the scene.
        """
        self._moving.place(self.body_q, frame)
        at = *frame.position, frame.turn
        if at != self._fixed_at:
            self._fixed_at = at
            self._fixed.place(self.body_q, frame)

    def remove(self) -> None:
        """Take all shapes from the browser."""
        for batch in self.batches:
            batch.handle.remove()
        self.batches, self._moving, self._fixed = [], _Placed([]), _Placed([])

    def _add_batches(self) -> None:
        shapes = self.model.model
        if not shapes.shape_count:
            return
        flags, bodies = shapes.shape_flags.numpy(), shapes.shape_body.numpy()
        kinds = self.model.kinds
        scales, local, colors = shapes.shape_scale.numpy(), shapes.shape_transform.numpy(), shapes.shape_color.numpy()
        groups: dict[tuple[object, ...], list[int]] = {}
        scenery = set(self.model.scenery.tolist())  # hidden from the renderer of pictures, which traces it apart
        for i in range(shapes.shape_count):
            if not int(flags[i]) & int(newton.ShapeFlags.VISIBLE) and i not in scenery:
                continue
            if kinds[i] == int(newton.GeoType.PLANE) and not scales[i][:2].any():
                self.grounds.append(compose(self._pose(int(bodies[i]))[None], local[i][None])[0])
                continue
            groups.setdefault(self._key(i, int(kinds[i]), scales[i]), []).append(i)
        room = _MOST_FIXED
        for number, rows in enumerate(sorted(groups.values(), key=len)):
            index = np.array(rows)
            is_fixed = not (bodies[index] >= 0).any()
            room -= len(rows) if is_fixed else 0
            node = f"{WORLD if is_fixed and room < 0 else VIEW}/shape_{number}"
            self._add(node, index, scales[index], local[index], bodies[index], colors[index])

    def _pose(self, body: int) -> np.ndarray:
        return self.body_q[body] if body >= 0 else np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def _key(self, shape: int, kind: int, scale: np.ndarray) -> tuple[object, ...]:
        """Key that shapes of one mesh share."""
        source = self.model.sources[shape]
        if kind == int(newton.GeoType.MESH):
            # A mirror turns the triangles, which is done in the mesh.
            return kind, id(source), bool(np.prod(np.sign(scale)) < 0.0)
        if kind in map(int, _UNIT):
            return (kind,)
        return kind, id(source), *np.round(scale, 6).tolist()

    def _add(
        self,
        node: str,
        shapes: np.ndarray,
        scales: np.ndarray,
        local: np.ndarray,
        bodies: np.ndarray,
        colors: np.ndarray,
    ) -> None:
        """Add a batch of shapes that have one mesh."""
        first = int(shapes[0])
        kind = int(self.model.kinds[first])
        vertices, faces, sizes = self._mesh(first, kind, scales)
        if kind in _ROUND and self.model.body_count:
            rank = np.where(bodies >= 0, bodies % self.model.body_count % 6, 0)
            sizes = sizes * np.where(
                [True, True, kind == int(newton.GeoType.SPHERE)], 1.0 - _THINNER * rank[:, None], 1
            )
        poses = _world_poses(self.body_q, bodies, local)
        if not (bodies >= 0).any():
            self.sight_line.add(vertices, faces, sizes, poses)
        args: dict[str, object] = {
            "batched_positions": poses[:, :3].astype(np.float32),
            "batched_wxyzs": wxyz(poses[:, 3:]),
            "batched_scales": sizes.astype(np.float32),
            "lod": "off",  # simplified meshes have holes
        }
        scene = self._server.scene
        glb = self._file(first, vertices, faces, colors[0], poses[0])
        if glb is not None:
            handle: viser.BatchedMeshHandle | viser.BatchedGlbHandle = scene.add_batched_glb(node, glb, **args)
        else:
            # Single sheets of triangles, as scanned grounds have them, are seen from both sides. On what is drawn from
            # both sides a browser's shadows have stripes, so solids, such as walls, are not.
            is_sheet = kind == int(newton.GeoType.MESH) and not is_closed(vertices, faces)
            args["side"] = "double" if is_sheet or kind == int(newton.GeoType.PLANE) else "front"
            # The corners of a terrain belong to faces of all directions.
            args["flat_shading"] = kind == int(newton.GeoType.HFIELD)
            handle = scene.add_batched_meshes_simple(node, vertices, faces, batched_colors=linear_bytes(colors), **args)
        self.batches.append(ShapeBatch(handle, bodies.astype(int), local.astype(float), node.startswith(VIEW)))

    def _file(
        self, shape: int, vertices: np.ndarray, faces: np.ndarray, color: np.ndarray, pose: np.ndarray
    ) -> bytes | None:
        """The mesh of a batch as a GLB file, if it has a texture; else None."""
        source, kind = self.model.sources[shape], int(self.model.kinds[shape])
        if kind == int(newton.GeoType.HFIELD):
            return ground_file(source, pose, vertices, faces) if has_colors(source) else None
        if kind != int(newton.GeoType.MESH):
            return None
        if getattr(source, "foliage", ""):
            return foliage_file(source, np.array(newton.utils.color_srgb_to_linear(tuple(map(float, color)))))
        picture = _picture(source)
        if picture is None:
            return None
        uvs = np.asarray(source.uvs, dtype=float) * (1.0, -1.0) + (0.0, 1.0)
        return glb_of(vertices, faces, uvs=uvs, picture=picture)

    def _mesh(self, shape: int, kind: int, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices and faces of the mesh of a batch, and the factors of its instances, shape ``(n, 3)``."""
        source, label = self.model.sources[shape], f"shape {shape}"
        if kind == int(newton.GeoType.MESH):
            mirror = np.where(np.prod(np.sign(scales[0])) < 0.0, -1.0, 1.0)
            factor = np.array([mirror, 1.0, 1.0])
            vertices, faces = shape_mesh(kind, factor, source, label)
            return vertices, faces, np.abs(scales) if mirror < 0.0 else scales
        if kind == int(newton.GeoType.HFIELD) and (scales[0] > 0.0).all():
            vertices, _ = shape_mesh(kind, scales[0], source, label)
            tolerance = _GROUND_TOLERANCE if has_colors(source) else _FIELD_TOLERANCE
            vertices, faces = merged_field(vertices.reshape(int(source.nrow), int(source.ncol), 3), tolerance)
            return vertices, faces, np.ones((len(scales), 3))
        if kind in map(int, _UNIT):
            axes = list(_UNIT[newton.GeoType(kind)])
            vertices, faces = shape_mesh(kind, np.ones(3), source, label, _FACETS_OFF)
            return vertices, faces, scales[:, axes]
        vertices, faces = shape_mesh(kind, scales[0], source, label, _FACETS_OFF * max(float(scales[0][0]), 1e-3))
        return vertices, faces, np.ones((len(scales), 3))


def _world_poses(body_q: np.ndarray, bodies: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Poses of shapes on bodies, -1 for the world; those that are not finite are far away, shape ``(n, 7)``."""
    world = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    poses = compose(np.concatenate([body_q, world])[bodies], local)  # body -1 is the last row
    poses[~np.isfinite(poses).all(axis=1)] = (*_AWAY, 0.0, 0.0, 0.0, 1.0)
    return poses


def linear_bytes(colors: np.ndarray) -> np.ndarray:
    """Colours in sRGB from 0 to 1, ``(n, 3)``, as viser takes those of instances: linear, uint8."""
    linear = np.array([newton.utils.color_srgb_to_linear(tuple(map(float, color))) for color in colors])
    return np.round(255.0 * np.clip(linear, 0.0, 1.0)).astype(np.uint8).reshape(-1, 3)


def _picture(source: object) -> np.ndarray | None:
    """The texture of a mesh, uint8 ``(height, width, 3)``; None if it has none that can be read."""
    texture, uvs = getattr(source, "texture", None), getattr(source, "uvs", None)
    if texture is None or uvs is None:
        return None
    if isinstance(texture, str):
        from PIL import Image  # comes with viser

        try:
            with Image.open(Path(texture)) as image:
                return np.asarray(image.convert("RGB"))
        except OSError:
            return None
    picture = np.asarray(texture)
    if picture.dtype != np.uint8:
        picture = np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
    return picture[..., :3] if picture.ndim == 3 and picture.shape[2] >= 3 else None
