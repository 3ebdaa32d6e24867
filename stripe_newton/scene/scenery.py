# SPDX-License-Identifier: Apache-2.0
"""Scenery: static assets that occur many times, as instances of prototypes in USD.

Newton's importer visits every prim of every instance, of which a forest has tens of thousands. Here a prototype is read
once, and of its instances their transforms alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import newton
import numpy as np
import warp as wp
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from .capsules import Capsules

__all__ = [
    "FOLIAGE_KEY",
    "SCENERY_KEY",
    "Prototype",
    "Scenery",
    "add_scenery",
    "hidden",
    "read_scenery",
    "scenery_groups",
]

SCENERY_KEY = "stripeNewton:scenery"
"""Attribute of a prim whose children are all instances of static prototypes, placed by translate, orient and scale."""


FOLIAGE_KEY = "stripeNewton:foliage"
"""Attribute of a mesh whose triangles are bunches of leaves or twigs: which kind, see ``MeshPart.foliage``."""


@dataclass
class Shape:
    """A collider of a prototype, in its frame."""

    kind: str
    size: tuple[float, ...]
    pos: np.ndarray
    rot: np.ndarray


@dataclass
class Prototype:
    """Meshes and colliders of the instances of one prototype.

    Attributes:
        path: Prim path in the stage.
        meshes: Visible meshes, with their colours.
        shapes: Colliders.
    """

    path: str
    meshes: list[tuple[newton.Mesh, tuple[float, float, float]]] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)


@dataclass
class Scenery:
    """Instances in the order of the stage.

    Attributes:
        prototypes: The prototypes.
        paths: Path of each instance.
        which: Index of its prototype, int ``(N,)``.
        pos: Position [m], ``(N, 3)``.
        rot: Orientation, xyzw ``(N, 4)``.
        scale: Factor on its size, ``(N,)``.
    """

    prototypes: list[Prototype]
    paths: list[str]
    which: np.ndarray
    pos: np.ndarray
    rot: np.ndarray
    scale: np.ndarray

    def capsules(self) -> Capsules:
        """Colliders as capsules in the world; a cylinder becomes the capsule of its radius and half length.

        Raises:
            ValueError: for a box, which is no capsule.
        """
        found: list[Capsules] = []
        poses = np.concatenate([self.pos, self.rot], axis=1)
        for index, prototype in enumerate(self.prototypes):
            own = np.flatnonzero(self.which == index)
            if prototype.shapes and len(own):
                try:
                    found.append(Capsules.from_colliders(prototype.shapes, poses[own], self.scale[own]))
                except ValueError as error:
                    raise ValueError(f"assets like '{prototype.path}': {error}") from error
        names = "positions", "rotations", "radius", "half_length"
        if not found:
            return Capsules.none()
        return Capsules(*(np.concatenate([getattr(part, name) for part in found]) for name in names))

    def _poses(self, own: np.ndarray, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

        turn = Rotation.from_quat(self.rot[own])
        pos = self.pos[own] + self.scale[own, None] * turn.apply(shape.pos)
        return pos, (turn * Rotation.from_quat(shape.rot)).as_quat()


def scenery_groups(stage: Usd.Stage) -> list[Usd.Prim]:
    """Prims whose children are all instances of static prototypes, as their :data:`SCENERY_KEY` says."""
    root = stage.GetDefaultPrim() or stage.GetPseudoRoot()
    found = [p for p in root.GetChildren() if p.GetAttribute(SCENERY_KEY) and p.GetAttribute(SCENERY_KEY).Get()]
    return [p for p in found if p.GetChildren()]


@contextmanager
def hidden(stage: Usd.Stage, prims: list[Usd.Prim]) -> Iterator[None]:
    """Deactivate prims meanwhile, so that importers do not visit them, nor the thousands below them."""
    # In the session layer, which no export writes: the stage itself does not change.
    session = Usd.EditContext(stage, stage.GetSessionLayer())
    with session, Sdf.ChangeBlock():
        for prim in prims:
            prim.SetActive(False)
    try:
        yield
    finally:
        with session, Sdf.ChangeBlock():
            for prim in prims:
                prim.ClearActive()


def read_scenery(stage: Usd.Stage) -> Scenery:
    """The instances below all :func:`scenery_groups`.

    Raises:
        ValueError: for a child that is no reference, or whose transform is more than a move, a turn and a size.
    """
    prototypes: dict[str, int] = {}
    made: list[Prototype] = []
    paths, which, rows = list[str](), list[int](), list[Gf.Matrix4d]()
    for group in scenery_groups(stage):
        base = UsdGeom.XformCache().GetLocalToWorldTransform(group)
        if base != Gf.Matrix4d(1.0):
            raise ValueError(f"'{group.GetPath()}': is moved; its instances must be placed in the world's frame")
        for prim in group.GetChildren():
            if not prim.HasAuthoredReferences():
                raise ValueError(f"'{prim.GetPath()}': must be a reference to a prototype, better an instanceable one")
            # Instances of one file share a prototype of the stage; what is not instanceable is one by itself.
            key = str((prim.GetPrototype() if prim.IsInstance() else prim).GetPath())
            if key not in prototypes:
                prototypes[key] = len(made)
                made.append(_prototype(prim))
            which.append(prototypes[key])
            paths.append(str(prim.GetPath()))
            rows.append(UsdGeom.Xformable(prim).GetLocalTransformation())
    places = _places(np.array(rows, dtype=float).reshape(-1, 4, 4), paths)
    return Scenery(made, paths, np.array(which, dtype=int), *places)


def _places(matrices: np.ndarray, paths: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, orientations and scales of transforms as USD writes them: of rows, the last the translation."""
    if not len(matrices):
        return np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0)
    from scipy.spatial.transform import Rotation  # see above

    axes = matrices[:, :3, :3]
    scale = np.linalg.norm(axes, axis=2)
    skewed = np.abs(axes @ axes.transpose(0, 2, 1) - scale[:, :1, None] ** 2 * np.eye(3)).max(axis=(1, 2))
    # The tolerance is what float32 and a few products of it leave; a mirror has a negative determinant.
    wrong = np.flatnonzero((skewed > 2.0e-5 * scale[:, 0] ** 2) | (np.linalg.det(axes) <= 0.0))
    if len(wrong):
        sizes = tuple(float(round(s, 6)) for s in scale[wrong[0]])
        raise ValueError(f"'{paths[wrong[0]]}': scale is {sizes}, must be the same along all axes, no shear, no mirror")
    turn = Rotation.from_matrix((axes / scale[:, :1, None]).transpose(0, 2, 1))
    return matrices[:, 3, :3], turn.as_quat(), scale[:, 0]


def _prototype(instance: Usd.Prim) -> Prototype:
    found, cache = Prototype(str(instance.GetPath())), UsdGeom.XformCache()
    inverse = cache.GetLocalToWorldTransform(instance).GetInverse()
    for prim in Usd.PrimRange(instance, Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Gprim):
            continue
        matrix = cache.GetLocalToWorldTransform(prim) * inverse
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            found.shapes.append(_shape(prim, matrix))
        elif prim.IsA(UsdGeom.Mesh):
            read = newton.usd.get_mesh(prim, compute_inertia=False, load_visual_materials=False)
            points = np.asarray(read.vertices) @ np.array(matrix)[:3, :3] + np.array(matrix)[3, :3]
            colors = UsdGeom.Mesh(prim).GetDisplayColorAttr().Get()
            red, green, blue = map(float, colors[0]) if colors else (0.5, 0.5, 0.5)
            mesh = newton.Mesh(points.astype(np.float32), read.indices, compute_inertia=False)
            # No attribute of Newton's: viewers draw both sides of meshes that have it, such as leaves.
            mesh.two_sided = bool(UsdGeom.Mesh(prim).GetDoubleSidedAttr().Get())
            foliage = prim.GetAttribute(FOLIAGE_KEY)
            mesh.foliage = str(foliage.Get()) if foliage else ""
            found.meshes.append((mesh, newton.utils.color_linear_to_srgb((red, green, blue))))
    return found


def _shape(prim: Usd.Prim, matrix: Gf.Matrix4d) -> Shape:
    """The primitive of a collider, with the scale of its transform in its size.

    Raises:
        ValueError: for a collider that is no sphere, capsule, cylinder or box along z.
    """
    pose = Gf.Transform(matrix)
    factor, turn = np.array(pose.GetScale()), pose.GetRotation().GetQuat()
    pos, rot = np.array(pose.GetTranslation()), np.array([*turn.GetImaginary(), turn.GetReal()])
    get = {n: prim.GetAttribute(n).Get() for n in ("radius", "height", "axis", "size") if prim.HasAttribute(n)}
    kind = prim.GetTypeName()
    if kind == "Cube":
        return Shape("box", tuple(0.5 * get["size"] * factor), pos, rot)
    if kind == "Sphere":
        return Shape("sphere", (get["radius"] * factor[0],), pos, rot)
    if kind in ("Capsule", "Cylinder") and get["axis"] == "Z":
        return Shape(kind.lower(), (get["radius"] * factor[0], 0.5 * get["height"] * factor[2]), pos, rot)
    raise ValueError(f"'{prim.GetPath()}': colliders of scenery are Sphere, Cube, or Capsule or Cylinder along Z")


def add_scenery(builder: newton.ModelBuilder, scenery: Scenery, touched: bool = True) -> None:
    """Add the shapes of all instances to what all environments share.

    Args:
        builder: Of the static scene.
        scenery: The instances.
        touched: Whether colliders become shapes; False where collider slots stand for them.
    """
    # What is seen and what is touched are shapes of their own: visible meshes without contacts, hidden primitives.
    seen = newton.ModelBuilder.ShapeConfig(density=0.0, has_shape_collision=False, has_particle_collision=False)
    solid = builder.default_shape_cfg.copy()
    solid.density, solid.is_visible = 0.0, False
    for index, prototype in enumerate(scenery.prototypes):
        own = np.flatnonzero(scenery.which == index)
        paths, poses = [scenery.paths[i] for i in own], np.hstack([scenery.pos[own], scenery.rot[own]])
        for part, (mesh, color) in enumerate(prototype.meshes):
            add = partial(builder.add_shape_mesh, -1, mesh=mesh, cfg=seen, color=color)
            _repeat(builder, add, poses, scenery.scale[own], [f"{path}/part_{part}" for path in paths])
        for part, shape in enumerate(prototype.shapes if touched else ()):
            poses = np.hstack(scenery._poses(own, shape))
            add = partial(_add, builder, shape, solid)
            _repeat(builder, add, poses, scenery.scale[own], [f"{path}/collider_{part}" for path in paths])


def _repeat(
    builder: newton.ModelBuilder, add: Callable[[], object], poses: np.ndarray, scales: np.ndarray, labels: list[str]
) -> None:
    """Add a static shape at many poses; one by one Newton takes 30 us for each.

    The shape is added once by Newton. Every list of the builder that this made longer is then filled up with copies of
    its last entry, and what differs between instances is written over them.

    Args:
        builder: Of the static scene.
        add: Adds the shape once, of size 1.
        poses: Positions [m] and orientations, xyzw ``(N, 7)``.
        scales: Factors on its size, ``(N,)``.
        labels: Of the N shapes.
    """
    # Newton keeps shapes in parallel lists, shape_*, to which its versions add: so by name, not one by one.
    first = builder.shape_count
    lengths = {n: len(v) for n, v in vars(builder).items() if n.startswith("shape_") and isinstance(v, list)}
    add()
    for column in (getattr(builder, n) for n, length in lengths.items() if len(getattr(builder, n)) == length + 1):
        column.extend(column[-1:] * (len(labels) - 1))
    size, radius = np.array(builder.shape_scale[first]), builder.shape_collision_radius[first]
    builder.body_shapes[-1].extend(range(first + 1, builder.shape_count))
    builder.shape_transform[first:] = [wp.transform(*pose) for pose in poses.tolist()]
    builder.shape_scale[first:] = [tuple(row) for row in (scales[:, None] * size).tolist()]
    builder.shape_collision_radius[first:] = (scales * radius).tolist()
    builder.shape_label[first:] = labels


def _add(builder: newton.ModelBuilder, shape: Shape, cfg: newton.ModelBuilder.ShapeConfig) -> None:
    if shape.kind == "box":
        builder.add_shape_box(-1, hx=shape.size[0], hy=shape.size[1], hz=shape.size[2], cfg=cfg)
    elif shape.kind == "sphere":
        builder.add_shape_sphere(-1, radius=shape.size[0], cfg=cfg)
    else:
        add = builder.add_shape_capsule if shape.kind == "capsule" else builder.add_shape_cylinder
        add(-1, radius=shape.size[0], half_height=shape.size[1], cfg=cfg)
