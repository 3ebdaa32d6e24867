# SPDX-License-Identifier: Apache-2.0
"""The constructing face of a scene: from prims to a model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import newton
import warp as wp
from pxr import Usd, UsdGeom

from stripe_newton.assets import Articulation, ArticulationCfg, AssetBase, Layout, RigidObject, articulation_layouts
from stripe_newton.configclass import ConfigError
from stripe_newton.sim.spawners.from_files import FILE_KEY
from stripe_newton.sim.stage import ENV_0
from stripe_newton.usd import StageReport, joint_rows, load_stage, read_lights

from .contents import SceneContents
from .mjcf import complete_mjcf, count_actuators
from .scenery import Scenery, add_scenery, hidden, read_scenery, scenery_groups

__all__ = ["SceneBuilder"]


class SceneBuilder:
    """Adds assets to a scene under construction, then makes its model.

    Attributes:
        reports: What the importer read and ignored: of one environment, and of what all share.
        template_root: Prim that is one environment; ``"/"`` for a stage that knows no environments.
        adopt: Make assets of the articulations that the stage brings.
    """

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self.reports: list[StageReport] = []
        self.template_root = ENV_0
        self.adopt = False

    # -- adding

    def build_terrain(self, cfg: Any, name: str = "terrain") -> Any:
        """Add what the environments stand on; it becomes ``scene.terrain``."""
        self._scene.terrain = self._make(cfg)
        return self._scene.terrain

    def build_robot(self, name: str, cfg: Any) -> Any:
        """Add an articulation; it becomes ``scene.articulations[name]``."""
        self._scene.articulations[name] = self._make(cfg)
        return self._scene.articulations[name]

    def build_objects(self, objects: Mapping[str, Any]) -> dict[str, Any]:
        """Add rigid objects and static assets by name; they become ``scene.rigid_objects`` and ``scene.extras``."""
        made = {name: self._make(cfg) for name, cfg in objects.items()}
        for name, asset in made.items():
            (self._scene.rigid_objects if isinstance(asset, RigidObject) else self._scene.extras)[name] = asset
        return made

    def build_sensors(self, sensors: Mapping[str, Any]) -> dict[str, Any]:
        """Add sensors by name; they become ``scene.sensors``. They bind to the model after the assets."""
        made = {name: self._make(cfg) for name, cfg in sensors.items()}
        self._scene.sensors.update(made)
        return made

    def _make(self, cfg: Any) -> Any:
        with self._scene.construction():
            return (cfg.class_type or AssetBase)(cfg)

    # -- making the model

    def build(self) -> None:
        """Load the stage, write configs onto the environment's builder, replicate it, bind the assets."""
        stage = self._scene.stage
        if self._scene.built:
            raise RuntimeError("the scene is built already")
        scenery = read_scenery(stage)
        with hidden(stage, scenery_groups(stage)):
            self._build(scenery)

    def _build(self, scenery: Scenery) -> None:
        scene, sim = self._scene, self._scene.sim
        template = sim.new_builder()
        fields = self._find_terrain()
        self._load(template, self.template_root, fields if self.template_root == "/" else ())
        layouts = articulation_layouts(template)
        if self.adopt:
            self._adopt(layouts)
        problems = []
        for asset in scene.assets:
            try:
                asset.prepare(layouts, template)
            except ConfigError as error:
                problems += error.problems
        if problems:
            raise ConfigError(problems)
        self.reports[0].joints = joint_rows(template)  # with the drives of the actuator configs
        static = self._shared(scenery, fields)
        if self.template_root != "/" and self.reports[0].units["scene"] is None:
            template.gravity = static.gravity  # the physics scene stands outside the environments
        for obstacles in self.takers:
            obstacles.take(scenery)
        for sensor in sorted(scene.sensors.values(), key=lambda s: not getattr(s, "adds_shapes", False)):
            sensor.prepare(sim, template, static)  # those that add shapes before those that count them
        scene.built = True
        sim.lights = read_lights(scene.stage)
        sim.env_origin = wp.from_torch(scene.env_origins, dtype=wp.vec3)
        sim.build(template, static, scene.env_origins.cpu().numpy().copy())
        for asset in [*scene.assets, *scene.sensors.values()]:
            asset.initialize(sim)
        sim.after_each = [s.launch_substep for s in scene.sensors.values() if s.every_substep]

    @property
    def takers(self) -> list[Any]:
        """Sensors that let robots touch the scenery, whose colliders are no shapes then."""
        return [s for s in self._scene.sensors.values() if getattr(s.cfg, "of_scenery", False)]

    def _shared(self, scenery: Scenery, fields: tuple[str, ...]) -> newton.ModelBuilder:
        """What all environments share, but for what sensors add."""
        scene, static = self._scene, self._scene.sim.new_builder()
        if self.template_root != "/":
            self._load(static, "/World", ("/World/envs", *fields))
        add_scenery(static, scenery, touched=not self.takers)
        if hasattr(scene.terrain, "add_to"):
            scene.terrain.add_to(static)
        return static

    def rebuild_shared(self, scenery: Scenery) -> None:
        """Make what all environments share anew from the stage, for what draws the scene; the model stays."""
        scene, reports = self._scene, self.reports
        with hidden(scene.stage, scenery_groups(scene.stage)):
            self.reports = reports[:1]
            scene.sim.static = self._shared(scenery, (f"{scene.terrain.path}/terrain",))
        scene.sim.lights = read_lights(scene.stage)

    def _find_terrain(self) -> tuple[str, ...]:
        """Make the terrain of a height field that an exported stage holds; its path, which no importer is to read."""
        from stripe_newton.terrains.terrain_importer import found_terrain

        if self._scene.terrain is None and (cfg := found_terrain(self._scene.stage)) is not None:
            self.build_terrain(cfg)
        terrain = self._scene.terrain
        return (f"{terrain.path}/terrain",) if getattr(terrain, "ground", None) is not None else ()

    def _load(self, builder: newton.ModelBuilder, root: str, ignore: tuple[str, ...]) -> None:
        stage = self._scene.stage
        files = self._file_prims(stage, root, ignore)
        report = load_stage(builder, stage, root_path=root, ignore_paths=ignore, solver=self._scene.sim.cfg.solver.kind)
        for prim, options in files:
            _import_file(builder, prim, dict(options))
        self.reports.append(report)

    def _file_prims(self, stage: Usd.Stage, root: str, ignore: tuple[str, ...]) -> list[tuple[Usd.Prim, dict]]:
        prims = (p for p in Usd.PrimRange(stage.GetPrimAtPath(root)) if p.GetCustomDataByKey(FILE_KEY))
        inside = [p for p in prims if not (ignore and str(p.GetPath()).startswith("/World/envs"))]
        return [(p, json.loads(p.GetCustomDataByKey(FILE_KEY))) for p in inside]

    def _adopt(self, layouts: list[Layout]) -> None:
        """Make assets of the articulations and free bodies of a stage that somebody else laid out."""
        scene = self._scene
        for layout in layouts:
            single = layout.floating and len(layout.bodies) == 1
            family: dict[str, Any] = scene.rigid_objects if single else scene.articulations
            name = _unique(layout.path.rsplit("/", 1)[-1], scene.keys())
            family[name] = (_FoundBody if single else _FoundArticulation)(layout)
            scene.assets.append(family[name])


def _unique(name: str, taken: list[str]) -> str:
    number = 1
    while (candidate := name if number == 1 else f"{name}_{number}") in taken:
        number += 1
    return candidate


def _import_file(builder: newton.ModelBuilder, prim: Usd.Prim, options: dict[str, Any]) -> None:
    """Import the URDF or MJCF file that ``prim`` stands for, with labels below its path."""
    kind, path = options.pop("format"), options.pop("path")
    pose = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
    position, rotation = pose.ExtractTranslation(), pose.ExtractRotationQuat()
    xform = wp.transform(wp.vec3(*position), wp.quat(*rotation.GetImaginary(), rotation.GetReal()))
    counts = builder.body_count, builder.joint_count, builder.shape_count, builder.articulation_count
    keyframe, actuators = options.pop("keyframe", None), count_actuators(builder)
    add = builder.add_urdf if kind == "urdf" else builder.add_mjcf
    _take_newton_for_pgs(builder)
    shapes, default_friction = builder.default_shape_cfg, builder.default_shape_cfg.mu
    try:
        shapes.mu = 1.0 if kind == "mjcf" else default_friction  # what MuJoCo means where a file says nothing
        add(path, xform=xform, **options)
        if kind == "mjcf":
            complete_mjcf(builder, path, counts[1], actuators, keyframe, xform, options["scale"])
    except Exception as error:
        raise ValueError(f"{kind.upper()} file '{path}' at '{prim.GetPath()}': {error}") from error
    finally:
        shapes.mu = default_friction
    if builder.body_count == counts[0]:
        raise ValueError(f"{kind.upper()} file '{path}' at '{prim.GetPath()}' has no bodies")
    labels = (builder.body_label, builder.joint_label, builder.shape_label, builder.articulation_label)
    for label, start in zip(labels, counts, strict=True):
        label[start:] = [f"{prim.GetPath()}/{name}" for name in label[start:]]
    if builder.articulation_count == counts[3] + 1:
        builder.articulation_label[-1] = str(prim.GetPath())


def _take_newton_for_pgs(builder: newton.ModelBuilder) -> None:
    """Let an MJCF file ask for the PGS solver, which MuJoCo Warp has not: it gets Newton's method."""
    attribute = builder.custom_attributes.get("mujoco:solver")
    if attribute is not None and attribute.mjcf_value_transformer is not None:
        read = attribute.mjcf_value_transformer
        attribute.mjcf_value_transformer = lambda value, context: read("newton" if value == "PGS" else value, context)


class _Found:
    """An asset that a stage brings itself: bound to its articulation, nothing is spawned."""

    def __init__(self, layout: Layout):
        state = ArticulationCfg.InitialStateCfg(pos=None, rot=None, joint_pos=None, joint_vel={})
        self.cfg: Any = ArticulationCfg(prim_path=layout.path, articulation_root_prim_path="", init_state=state)
        self.path = layout.path

    in_every_env = True


class _FoundArticulation(_Found, Articulation):
    pass


class _FoundBody(_Found, RigidObject):
    pass
