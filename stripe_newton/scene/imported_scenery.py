# SPDX-License-Identifier: Apache-2.0
"""Imported scenery: a stage that somebody else wrote, as the world of all environments of a scene.

Its static shapes are shared by all environments; of its rigid bodies each environment has copies of its own. It takes
the place of the task's ground where it has a floor, and robots start where they have room on its floors.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import newton
import numpy as np
import warp as wp
from newton import GeoType, JointType
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

from stripe_newton.collision_tables import finalize_without_tables
from stripe_newton.sim import Simulation
from stripe_newton.sim.contact_capacity import contact_capacity
from stripe_newton.solvers.static_meshes import count_marks
from stripe_newton.terrains.collider_mesh import start_poses, static_colliders, triangles_of
from stripe_newton.terrains.scenery_ground import SceneryGround, Triangles
from stripe_newton.terrains.start_spots import Floors, choose_spots, find_floors
from stripe_newton.usd import StageError, StageReport, ignored_text

from .scene_contents import SceneContents
from .scenery_reset import SceneryReset
from .scenery_stage import author_scenery

__all__ = ["ImportedScenery"]

_ROOM = 0.05
"""Free space around and above what stands in an environment at its start [m]."""
_NO_COLLIDERS = (0.3, 0.5)
"""Radius and height that an environment without colliders gets [m]."""
_GROUND = "the task's ground"
"""Name of it in the rows of the report."""
_FLOOR_SHARE = 0.25
"""Share of its extent that the floors of a stage cover if it brings its own ground."""


class ImportedScenery:
    """The scenery of a scene that is being built.

    Attributes:
        stage: Where it is in the scene's stage, and what of it moves.
        replaces: Whether it takes the place of the task's ground.
        joints: Joints of the template that come from the stage.
        reset: Reset of the scenery and of the places to start, once the model is built.
    """

    reset: SceneryReset

    def __init__(self, scene: SceneContents):
        """Copy the stage into that of the scene.

        Raises:
            StageError: if it cannot be simulated, or nothing in it collides.
        """
        assert scene.cfg.scenery_file is not None  # else the builder makes none
        self._scene, self._options = scene, scene.cfg.scenery_options
        self._grounds = _ground_paths(scene)
        ground = next(iter(self._grounds), None)
        solver = scene.sim.cfg.solver.kind
        self.stage = author_scenery(scene.stage, scene.cfg.scenery_file, self._options, solver, ground)
        self.replaces, self.joints = False, range(0)
        self._builder = scene.sim.new_builder()
        self._colliders = 0

    # -- loading, in the order in which the scene's builder calls it

    def measure(self, template: newton.ModelBuilder) -> None:
        """Measure what stands in one environment, before the stage's own bodies join it."""
        cfg = self._options.start
        radius, height = _room_of(template) if cfg.radius is None or cfg.height is None else (0.0, 0.0)
        self._radius, self._height = cfg.radius or radius, cfg.height or height
        # What is fixed to the world was built at the first place, so that its environment stays there.
        fixed_roots = [
            kind
            for kind, parent in zip(template.joint_type, template.joint_parent, strict=True)
            if parent < 0 and kind != JointType.FREE
        ]
        self._draws = not fixed_roots and all(body >= 0 for body in template.shape_body)
        self._first_joint = template.joint_count

    def loaded_bodies(self, template: newton.ModelBuilder) -> None:
        """Note which joints the stage has added to the template."""
        self.joints = range(self._first_joint, template.joint_count)

    @property
    def builder(self) -> newton.ModelBuilder:
        """Builder that the static shapes are read into."""
        return self._builder

    def decide_ground(self, report: StageReport) -> list[str]:
        """Decide what becomes of the task's ground, once the static shapes are read, with a row in the report.

        Returns:
            Paths of the prims that are left out of the shared scene.

        Raises:
            StageError: if there is nothing to stand on.
        """
        report.file = self.stage.file
        report.ignored.extend(self.stage.rows)
        shapes = static_colliders(self._builder)
        if not shapes:
            raise StageError(self.stage.file, "", "none of its static colliders was read; see stripe-newton inspect")
        self._colliders = len(shapes)
        triangles = Triangles(self._builder, shapes, self._scene.device)
        floors, _ = self._find_floors(triangles, triangles.mesh)
        wanted, has_floor = self._options.ground, bool(floors.areas) and floors.covered >= _FLOOR_SHARE
        self.replaces = wanted == "replace" or (wanted == "auto" and has_floor)
        if not self._grounds and not floors.areas:
            reason = (
                f"has no floor: of {floors.found} points with free space above {floors.free} have room for a body, "
                f"on no floor of {self._options.start.min_area:g} m^2 or more; and the task has no ground"
            )
            raise StageError(self.stage.file, "", reason)
        if not self._grounds:
            return []
        area = f"{floors.area:.1f} m^2 of floors over {100.0 * floors.covered:.0f} % of its extent"
        what = "is left out: the scenery has" if self.replaces else "is kept: the scenery has"
        for path in self._grounds:
            report.ignored.append((path, _GROUND, f"{what} {area}"))
        if not self.replaces:
            return []
        self._drop_grounds()
        return self._grounds

    def place(self, static: newton.ModelBuilder, template: newton.ModelBuilder) -> SceneryGround:
        """Choose where robots start, on everything that all environments share, and move the environments there.

        Args:
            static: What all environments share.
            template: One environment, with the stage's bodies, beside which robots start.

        Raises:
            StageError: if there are too few places.
        """
        scene = self._scene
        self._make_room(template, on_triangles=count_marks(static) > 0)
        triangles = Triangles(static, static_colliders(static), scene.device)
        kept = None if self.replaces else scene.terrain
        path = kept.path if kept is not None else self.stage.path.rpartition("/scenery")[0]
        path = path if path != "/World" else self.stage.path
        mesh = triangles.with_bodies(*self._own_bodies(template))
        floors, spots = self._find_floors(triangles, mesh, choose=True)
        return SceneryGround(path, triangles, floors, spots, scene.env_origins, kept, self.stage.labels)

    def _make_room(self, template: newton.ModelBuilder, on_triangles: bool) -> None:
        """Make room for the contacts of one environment in the solver's buffers.

        A task's own sizes are for flat ground, on which an arm may touch nothing, and a stage brings bodies of its own.
        """
        sim = self._scene.sim
        solver, room = sim.cfg.solver, contact_capacity(finalize_without_tables(template, "cpu"), on_triangles)
        sizes: dict[str, int] = {}
        for name, needed in zip(("nconmax", "njmax"), room, strict=True):
            given = getattr(solver, name, None)
            # Without a size MuJoCo Warp's own contacts get theirs from the model, and Newton's from the initial state.
            if hasattr(solver, name) and (given is not None or not solver.finds_contacts):
                sizes[name] = max(given or 0, needed)
        if sizes:
            sim.cfg = sim.cfg.replace(solver=solver.replace(**sizes))

    def _own_bodies(self, template: newton.ModelBuilder) -> tuple[np.ndarray, np.ndarray]:
        """Triangles of the stage's bodies as they stand when an episode begins."""
        bodies = {template.joint_child[j] for j in self.joints}
        shapes = [i for i in _colliders(template) if template.shape_body[i] in bodies]
        return triangles_of(template, shapes, start_poses(template) if shapes else None)

    def bind(self, sim: Simulation, ground: SceneryGround) -> None:
        """Make :attr:`reset`, once the model is built."""
        self.reset = SceneryReset(sim, ground, self.joints, self._draws)

    def _find_floors(self, triangles: Triangles, mesh: wp.Mesh, choose: bool = False) -> tuple[Floors, np.ndarray]:
        """Floors of a world, and the places to start on them if they are asked for.

        Raises:
            StageError: if there are too few places.
        """
        cfg = self._options.start
        try:
            floors = find_floors(mesh, triangles.bounds, cfg, self._radius, self._height)
            spots = choose_spots(mesh, floors, cfg, self._scene.num_envs) if choose else np.zeros((0, 3))
            return floors, spots
        except ValueError as error:
            raise StageError(self.stage.file, "", str(error)) from error

    def _drop_grounds(self) -> None:
        """Deactivate the task's ground in the stage, so that neither an export nor another importer has it."""
        stage = self._scene.stage
        for path in self._grounds:
            prim = stage.GetPrimAtPath(path)
            inside = Sdf.Path(self.stage.path).HasPrefix(prim.GetPath())
            for part in prim.GetChildren() if inside else [prim]:
                if str(part.GetPath()) != self.stage.path:
                    part.SetActive(False)

    # -- what is known of it

    def show_rows(self, reports: Sequence[StageReport]) -> None:
        """Warn of what was left out, converted or replaced. :meth:`describe` says what became of the ground."""
        own = (report for report in reports if report.file == self.stage.file)
        rows = [row for report in own for row in report.ignored if row[1] != _GROUND]
        if rows:
            warnings.warn(ignored_text(self.stage.file, rows), stacklevel=4)  # at the scene's build()

    def describe(self) -> str:
        """The scenery in one line: its file, shapes and bodies, the task's ground, the places to start."""
        ground = self._scene.terrain
        parts = [_count(self._colliders, "shared collider", "shared colliders")]
        if self.stage.bodies:
            parts.append(f"{_count(len(self.stage.bodies), 'body', 'bodies')} in each environment")
        if self._grounds:
            parts.append(f"the task's ground is {'left out' if self.replaces else 'kept'}")
        if isinstance(ground, SceneryGround):
            parts.append(ground.describe())
        if not self._draws:
            parts.append("each environment keeps its place, as it has something fixed to the world")
        return f"{self.stage.file}: {'; '.join(parts)}"


def _count(number: int, one: str, several: str) -> str:
    return f"{number} {one if number == 1 else several}"


def _ground_paths(scene: SceneContents) -> list[str]:
    """Prims that are the ground of a task: its terrain, its asset ``ground``, and every plane outside environments."""
    found = [] if scene.terrain is None else [scene.terrain.path]
    if "ground" in scene.extras:
        found.append(scene.extras["ground"].path)
    for prim in Usd.PrimRange(scene.stage.GetPseudoRoot()):
        path = str(prim.GetPath())
        if prim.IsA(UsdGeom.Plane) and prim.HasAPI(UsdPhysics.CollisionAPI) and not path.startswith("/World/envs/"):
            found.append(path)
    outer: list[str] = []
    for path in dict.fromkeys(found):
        if not any(path.startswith(f"{other}/") for other in found):
            outer.append(path)
    return outer


def _colliders(builder: newton.ModelBuilder) -> list[int]:
    """Colliders of a builder, without planes and height fields, which have no end."""
    solid, endless = int(newton.ShapeFlags.COLLIDE_SHAPES), (GeoType.PLANE, GeoType.HFIELD)
    kinds = zip(builder.shape_flags, builder.shape_type, strict=True)
    return [i for i, (flags, kind) in enumerate(kinds) if int(flags) & solid and kind not in endless]


def _room_of(template: newton.ModelBuilder) -> tuple[float, float]:
    """Radius around the origin and height above it that the colliders of one environment take at the start [m]."""
    points, _ = triangles_of(template, _colliders(template), start_poses(template))
    if not len(points):
        return _NO_COLLIDERS
    radius, height = np.linalg.norm(points[:, :2], axis=1).max(), points[:, 2].max()
    return float(radius) + _ROOM, max(float(height), 0.1) + _ROOM
