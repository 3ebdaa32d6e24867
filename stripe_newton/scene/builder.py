# SPDX-License-Identifier: Apache-2.0
"""Scene builder: adds assets to a scene and makes its model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, overload

import newton
import warp as wp

from stripe_newton.assets import (
    Articulation,
    ArticulationCfg,
    AssetBase,
    AssetBaseCfg,
    RigidObject,
    RigidObjectCollection,
    RigidObjectCollectionCfg,
    TerrainBase,
    TerrainBaseCfg,
    articulation_layouts,
)
from stripe_newton.assets.terrain_base import GroundAsset
from stripe_newton.configclass import ConfigError
from stripe_newton.sensors import SensorBase, SensorCfg
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.body_choice import BodyChoice
from stripe_newton.sim.scene_context import ENV_0, scene_context
from stripe_newton.terrains.scenery_ground import SceneryGround
from stripe_newton.terrains.terrain_importer import found_terrain
from stripe_newton.usd import (
    StageError,
    StageReport,
    check_content,
    joint_rows,
    read_lights,
    solver_reason,
    stage_name,
)
from stripe_newton.usd.concave_meshes import rows_by_triangles

from .body_choices import body_choices
from .export_joints import AuthoredJoints
from .found_assets import adopt_layouts
from .imported_scenery import ImportedScenery
from .new_stage import new_stage
from .obstacles import Obstacles
from .scene_contents import SceneContents
from .scene_parts import Part, part_kind
from .scenery import Scenery, add_scenery, hidden, read_scenery, scenery_groups
from .scenery_stage import paths_pattern
from .stage_reader import read_prims, use_mujoco_contacts

__all__ = ["SceneBuilder"]


class SceneBuilder:
    """Builds a scene: adds assets while it is under construction, then makes its model.

    Attributes:
        reports: What the importer read and ignored, of one environment and of what all share.
        template_root: Prim that is one environment; ``"/"`` for a stage without environments, which is one as a whole.
        adopt: Make assets of the articulations that the stage brings.
        allow_empty: Accept a scene in which nothing moves, or nothing is.
        checks: Functions that give problems of the config, called when all names are known and before the model is
            made, which takes longest.
        authored_joints: Joints of one environment as the stage gives them, before configs; None before the build.
        template_labels: Paths of its bodies, joints and shapes.
    """

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self.reports: list[StageReport] = []
        self.template_root = ENV_0
        self.adopt = self.allow_empty = False
        self.checks: list[Callable[[], Iterable[str]]] = []
        self.authored_joints: AuthoredJoints | None = None
        self.template_labels: list[str] = []
        self._authored: set[str] = set()
        """Names of the config's parts that have been added."""

    # -- adding

    def author(self) -> None:
        """Add all that the config names and that is not there yet, in the order of the config."""
        for name, cfg in self._configured():
            self._add(name, cfg)

    def _configured(self, kind: str | None = None) -> list[tuple[str, Part]]:
        """Parts that the config names and that are not there yet, of one kind or of all, by name.

        Raises:
            ValueError: for a field that is no asset and no sensor, or a name that a field and a dict both have.
        """
        parts = self._scene.cfg.parts()
        names = [name for name, _ in parts]
        for name, cfg in parts:
            if names.count(name) > 1:
                raise ValueError(f"scene.{name}: two parts have this name; give each its own")
            if part_kind(name, cfg) is None:
                raise ValueError(f"scene.{name}: {type(cfg).__name__} is no asset or sensor config")
        return [(n, c) for n, c in parts if n not in self._authored and kind in (None, part_kind(n, c))]

    def _add_kind(self, kind: str) -> list[str]:
        """Add what the config names of a kind; returns its names."""
        parts = self._configured(kind)
        for name, cfg in parts:
            self._add(name, cfg)
        return [name for name, _ in parts]

    def _add(self, name: str, cfg: Part) -> None:
        self._authored.add(name)
        kind = part_kind(name, cfg)
        if kind == "terrain":
            self.build_terrain(cfg)
        elif kind == "robot":
            self.build_robot(name, cfg)
        elif kind == "object":
            self.build_objects({name: cfg})
        elif kind == "collection":
            self.build_collection(name, cfg)
        else:
            self.build_sensors({name: cfg})

    def build_terrain(self, cfg: TerrainBaseCfg | AssetBaseCfg | None = None) -> TerrainBase | None:
        """Add the ground of the environments; it becomes ``scene.terrain``. By default it is that of the config."""
        if cfg is None:
            self._add_kind("terrain")
            return self._scene.terrain
        make: Callable[..., Any] = cfg.class_type or GroundAsset
        with self._scene.construction():
            self._scene.terrain = make(cfg)
        return self._scene.terrain

    @overload
    def build_robot(self, name: str, cfg: ArticulationCfg) -> Articulation: ...

    @overload
    def build_robot(self) -> dict[str, Articulation]: ...

    def build_robot(
        self, name: str | None = None, cfg: ArticulationCfg | None = None
    ) -> Articulation | dict[str, Articulation]:
        """Add an articulation; it becomes ``scene.articulations[name]``. By default all those of the config."""
        if name is None:
            return {n: self._scene.articulations[n] for n in self._add_kind("robot")}
        assert cfg is not None
        self._scene.articulations[name] = self._make(cfg)
        return self._scene.articulations[name]

    def build_objects(self, objects: Mapping[str, AssetBaseCfg] | None = None) -> dict[str, Any]:
        """Add rigid objects and static assets by name; they become ``scene.rigid_objects`` and ``scene.extras``.

        By default all those of the config.
        """
        if objects is None:
            return {n: self._scene[n] for n in self._add_kind("object")}
        made = {name: self._make(cfg) for name, cfg in objects.items()}
        for name, asset in made.items():
            if isinstance(asset, RigidObject):
                self._scene.rigid_objects[name] = asset
            else:
                self._scene.extras[name] = asset
        return made

    def build_collection(self, name: str, cfg: RigidObjectCollectionCfg) -> RigidObjectCollection:
        """Add a collection of rigid objects; it becomes ``scene.rigid_object_collections[name]``.

        Each of its objects becomes ``scene.rigid_objects["NAME_KEY"]``.

        Raises:
            ValueError: if something in the scene has the name of an object.
        """
        scene = self._scene
        made: RigidObjectCollection = self._make(cfg)
        for key, one in made.objects.items():
            own = f"{name}_{key}"
            if own in scene:
                raise ValueError(f"scene.{name}: its object '{key}' would be '{own}', which the scene has already")
            scene.rigid_objects[own] = one
        scene.rigid_object_collections[name] = made
        return made

    def build_sensors(self, sensors: Mapping[str, SensorCfg] | None = None) -> dict[str, SensorBase]:
        """Add sensors by name; they become ``scene.sensors``. They bind to the model after the assets.

        By default all those of the config.
        """
        if sensors is None:
            return {n: self._scene.sensors[n] for n in self._add_kind("sensor")}
        made = {name: self._make(cfg) for name, cfg in sensors.items()}
        self._scene.sensors.update(made)
        return made

    def _make(self, cfg: AssetBaseCfg | RigidObjectCollectionCfg | SensorCfg) -> Any:
        make: Callable[..., Any] = cfg.class_type or AssetBase
        with self._scene.construction():
            return make(cfg)

    # -- making the model

    def build(self) -> None:
        """Make the model: load the stage, write configs onto one environment, replicate it, bind assets and sensors."""
        stage = self._scene.stage
        if self._scene.built:
            raise RuntimeError("the scene is built already")
        # Newton's importer is kept from the instances, which are added from what was read of their prototypes.
        scenery = read_scenery(stage)
        with hidden(stage, scenery_groups(stage)):
            self._build(scenery)

    def _build(self, scenery: Scenery) -> None:
        """Go from the stage to a model, to which assets and sensors are bound."""
        scene, sim = self._scene, self._scene.sim
        if self.obstacle_sensors and sim.cfg.solver.chooses_contacts:  # their slots are geoms of MuJoCo Warp
            use_mujoco_contacts(sim, True)
        template = sim.new_builder()
        terrain_paths = self._find_terrain()
        if scene.cfg.scenery_file is not None:
            scene.scenery = ImportedScenery(scene)
        choices = self._load_environment(template, terrain_paths)
        static = self._shared(scenery, terrain_paths, template)
        if self.template_root == "/":
            static.gravity = template.gravity
        elif self.reports[0].units["scene"] is None:
            template.gravity = static.gravity  # the physics scene stands outside the environments
        for obstacles in self.obstacle_sensors:
            obstacles.use_scenery(scenery)
        # Sensors that add shapes come before those that count them; the order is otherwise that of the config.
        for sensor in sorted(scene.sensors.values(), key=lambda s: not s.adds_shapes):
            sensor.prepare(sim, template, static)
        if problems := [problem for check in self.checks for problem in check()]:
            raise ConfigError(problems)
        scene.built = True  # from here on nothing can be added: register() refuses it
        self._make_model(template, static, choices)
        self._bind()

    def _load_environment(self, template: newton.ModelBuilder, terrain_paths: tuple[str, ...]) -> list[BodyChoice]:
        """Load one environment, with the configs of its assets, and the bodies that an imported scenery brings.

        Returns:
            Bodies that are another asset in each environment.
        """
        scene, scenery = self._scene, self._scene.scenery
        self._load(template, self.template_root, terrain_paths if self.template_root == "/" else ())
        if self.template_root == "/" and not self.allow_empty:  # somebody else's stage, of which nothing may move
            check_content(template, self.reports[0])
        for asset in scene.assets:
            asset.arrange(template)
        self.authored_joints = AuthoredJoints(template)
        self.template_labels = [*template.body_label, *template.joint_label, *template.shape_label]
        self._prepare_assets(template)
        choices = body_choices(scene.assets, scene.num_envs, template, self._load_apart)
        self.reports[0].joints = joint_rows(template)  # after the actuator configs: with the drives that they set
        if scenery is not None:
            scenery.measure(template)
            if scenery.stage.bodies:
                self._load(template, scenery.stage.path, (scenery.stage.not_moving,))
                self.reports[-1].file = scenery.stage.file
            scenery.loaded_bodies(template)
        return choices

    def _make_model(
        self, template: newton.ModelBuilder, static: newton.ModelBuilder, choices: Sequence[BodyChoice]
    ) -> None:
        """Replicate the environment, make model and solver, and complete the reports.

        Raises:
            StageError: if the solver does not take the model; the error names the prim.
        """
        scene, sim = self._scene, self._scene.sim
        sim.lights = read_lights(scene.stage)
        # Kernels read the very tensor that a terrain moves; the model is replicated at a copy of where it is now.
        sim.env_origin = wp.from_torch(scene.env_origins, dtype=wp.vec3)
        own = range(0) if scene.scenery is None else scene.scenery.joints
        origins, imported = scene.env_origins.cpu().numpy().copy(), self.adopt or scene.scenery is not None
        may_be_static = self.adopt or self.allow_empty
        try:
            sim.build(template, static, origins, allow_static=may_be_static, unmoved=own, try_start=imported,
                      body_choices=choices)  # fmt: skip
        except ValueError as error:
            if "Element name" not in str(error):
                raise
            # MuJoCo's compiler, which names elements by names that Newton makes of the paths.
            raise StageError(stage_name(scene.stage), *solver_reason(self.template_labels, error)) from error
        if not sim.cfg.solver.finds_contacts:
            for report in self.reports:  # those of meshes that move were written before the solver was chosen
                report.ignored = rows_by_triangles(report.ignored)
        if scene.scenery is not None:
            scene.scenery.show_rows(self.reports)

    def _bind(self) -> None:
        """Bind scenery, assets and sensors to the model."""
        scene, sim = self._scene, self._scene.sim
        if scene.scenery is not None and isinstance(scene.terrain, SceneryGround):
            scene.scenery.bind(sim, scene.terrain)
        # Sensors come last: they read the arrays of assets, and as hooks run after what is added by the build.
        for asset in scene.assets:
            asset.initialize(sim)
        for sensor in scene.sensors.values():
            sensor.initialize(sim)
            sim.add_hook(sensor)

    def _prepare_assets(self, template: newton.ModelBuilder) -> None:
        """Prepare the assets: they find their bodies and write their configs onto the builder of one environment.

        Raises:
            ConfigError: everything that does not fit, of all assets at once.
        """
        layouts, problems = articulation_layouts(template), list[str]()
        if self.adopt:
            adopt_layouts(self._scene, layouts)
        for asset in self._scene.assets:
            try:
                asset.prepare(layouts, template)
            except ConfigError as error:
                problems += error.problems
        if problems:
            raise ConfigError(problems)

    @property
    def obstacle_sensors(self) -> list[Obstacles]:
        """Collider slots for the assets of the scene's specification, whose colliders then are no shapes."""
        return [s for s in self._scene.sensors.values() if isinstance(s, Obstacles) and s.cfg.of_scenery]

    def _shared(
        self, scenery: Scenery, terrain_paths: tuple[str, ...], template: newton.ModelBuilder
    ) -> newton.ModelBuilder:
        """The builder of what all environments share, but for what sensors add."""
        scene, static = self._scene, self._scene.sim.new_builder()
        imported, left_out = scene.scenery, ("/World/envs", *terrain_paths)
        if imported is not None:
            moves = imported.stage.not_static
            self._load(imported.builder, imported.stage.path, (moves,) if moves else ())
            # Only what was read shows whether it has a floor, and so whether the task's ground is needed.
            left_out += (paths_pattern([imported.stage.path, *imported.decide_ground(self.reports[-1])]),)
        if self.template_root != "/":
            self._load(static, "/World", left_out)
        add_scenery(static, scenery, touched=not self.obstacle_sensors)
        if scene.terrain is not None and not (imported is not None and imported.replaces):
            scene.terrain.add_to(static)
        if imported is not None:
            static.add_builder(imported.builder)
            scene.terrain = imported.place(static, template)
        return static

    def rebuild_shared(self, scenery: Scenery) -> None:
        """Rebuild what all environments share from the stage, for viewers to draw; the model stays."""
        scene, reports = self._scene, self.reports
        assert scene.terrain is not None  # only a scene with a height field can be regenerated
        with hidden(scene.stage, scenery_groups(scene.stage)):
            self.reports = reports[:1]
            scene.sim.static = self._shared(scenery, (f"{scene.terrain.path}/terrain",), scene.sim.template)
        scene.sim.lights = read_lights(scene.stage)

    def _find_terrain(self) -> tuple[str, ...]:
        """Make the terrain of a height field that an exported stage holds.

        Returns:
            Path of the height field, which importers must not read as a mesh; none without one.
        """
        if self._scene.terrain is None and (cfg := found_terrain(self._scene.stage)) is not None:
            self.build_terrain(cfg)
        terrain = self._scene.terrain
        return (f"{terrain.path}/terrain",) if terrain is not None and terrain.ground is not None else ()

    def _load(self, builder: newton.ModelBuilder, root: str, ignore: tuple[str, ...]) -> None:
        self.reports.append(read_prims(self._scene.sim, self._scene.stage, builder, root, ignore))

    def _load_apart(self, spawn: SpawnerCfg, asset: AssetBase) -> newton.ModelBuilder:
        """Builder of an asset that another environment than the first has in the place of one."""
        stage, builder = new_stage(), self._scene.sim.new_builder()
        with scene_context(SimpleNamespace(stage=stage, alias=self._scene.alias)):
            start = asset.cfg.init_state
            spawn.spawn(asset.cfg.prim_path, start.pos, start.rot_xyzw)
        report = read_prims(self._scene.sim, stage, builder, ENV_0, ())
        self.reports[0].ignored += [row for row in report.ignored if row not in self.reports[0].ignored]
        return builder
