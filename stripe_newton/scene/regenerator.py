# SPDX-License-Identifier: Apache-2.0
"""Scene regenerator: makes another scene of the same specification in a scene that is built.

Everything is written in place, as graphs hold the addresses of the arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import newton
from pxr import Sdf, Usd

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.sim import SceneSpawnerCfg
from stripe_newton.sim.height_field import replace_heights
from stripe_newton.terrains.ground_usd import ground_prims, placement, read_ground

from .builder import SceneBuilder
from .capsules import Capsules
from .scene_contents import SceneContents
from .scenery import Scenery, read_scenery

if TYPE_CHECKING:
    from stripe_newton.terrains import TerrainImporter

__all__ = ["SceneRegenerator"]


class SceneRegenerator:
    """Makes the scenes of other seeds of a specification.

    Attributes:
        seed: Seed that made the present scene; None if no specification made it.
        paths: Prims below ``/World`` that the specification made, once :meth:`regenerate` was called.
    """

    def __init__(self, scene: SceneContents, builder: SceneBuilder):
        self._scene, self._builder = scene, builder
        self.seed = self.first_seed
        self.paths: list[Sdf.Path] = []

    @property
    def first_seed(self) -> int | None:
        """Seed in the config, which made the first scene; None if no specification made it."""
        spawner = self._spawner()
        return None if spawner is None else spawner.seed

    def _spawner(self) -> SceneSpawnerCfg | None:
        """Config of the spawner that makes the scene from a specification or a file of one; None if there is none."""
        spawners = (part.spawn for _, part in self._scene.cfg.parts() if isinstance(part, AssetBaseCfg))
        return next((spawn for spawn in spawners if isinstance(spawn, SceneSpawnerCfg)), None)

    def why_not(self) -> str:
        """Reason why the scene of another seed cannot be made, and what to do about it; empty if it can."""
        scene, spawn = self._scene, self._spawner()
        if spawn is None:
            return "the scene is of no specification: make its config by SceneSpec.create_instance() or TrainingSpec"
        if problem := spawn.why_not_regenerable():
            return problem
        if not scene.built:
            return "the scene is not built yet: set the seed in its config"
        if scene.scenery is not None:
            return "the places to start in its imported scenery would not fit; make a new environment"
        for name, sensor in scene.sensors.items():
            if problem := sensor.why_not_regenerable(name, self._ground_shape):
                return problem
        template = scene.sim.template
        fixed = [label for label, body in zip(template.shape_label, template.shape_body, strict=True) if body < 0]
        if fixed:
            return (
                f"'{fixed[0]}' is fixed to the world in each environment, at the height of the ground that was there; "
                "give it a body, or leave it out"
            )
        if self._builder.obstacle_sensors:  # asked first, as reading the scenery of a forest takes a while
            return ""
        return _why_colliders_stay(read_scenery(scene.stage))

    @property
    def _terrain(self) -> TerrainImporter:
        """The terrain, which in a scene of a specification is a height field."""
        return cast("TerrainImporter", self._scene.terrain)

    @property
    def _ground_shape(self) -> int:
        """Shape of the model that is the height field."""
        return list(self._scene.sim.model.shape_label).index(f"{self._terrain.path}/terrain")

    def regenerate(self, seed: int) -> None:
        """Make the scene of a seed, see :meth:`InteractiveScene.regenerate`.

        Raises:
            ValueError: if something does not fit. Everything is checked before anything is written, so that the scene
                is then as it was.
        """
        scene, spawn, problem = self._scene, self._spawner(), self.why_not()
        if problem or spawn is None:
            raise ValueError(f"regenerate: {problem}")
        # What the first scene put there is known from making it once more, which is cached: the stage may hold prims of
        # assets beside it.
        if not self.paths:
            self.paths = _paths(spawn.made_stage())
        new = spawn.replace(seed=seed).made_stage()
        (prim,) = ground_prims(new)
        terrain, ground, scenery = self._terrain, read_ground(prim), read_scenery(new)
        obstacle_sensors = self._builder.obstacle_sensors
        try:
            terrain.check(ground)
            if not obstacle_sensors and (problem := _why_colliders_stay(scenery)):
                raise ValueError(problem)
            capsules = scenery.capsules() if obstacle_sensors else Capsules.none()
            for slots in obstacle_sensors:
                slots.check(capsules)
            _swap(scene.stage, self.paths, new)  # the last thing that may refuse
        except ValueError as error:
            raise ValueError(f"regenerate: seed {seed}: {error}") from error
        # From here on nothing refuses. Terrain, model, solver, sensors and viewers each have a copy of the ground.
        for name, value in placement(prim).items():
            setattr(terrain.cfg, name, value)
        terrain.replace(ground)
        shape = self._ground_shape
        _write_material(scene.sim.model, shape, terrain)
        replace_heights(scene.sim, shape, ground.source)
        for sensor in scene.sensors.values():
            sensor.replace_ground(shape, ground.heights)
        for slots in obstacle_sensors:
            slots.replace(capsules)
        self._builder.rebuild_shared(scenery)
        self.seed, self.paths = seed, _paths(new)


def _why_colliders_stay(scenery: Scenery) -> str:
    """Reason why colliders of a scenery that are shapes of the model cannot be replaced; empty if there are none."""
    touched = [p for i, p in enumerate(scenery.prototypes) if p.shapes and (scenery.which == i).any()]
    if not touched:
        return ""
    return (
        f"assets like '{touched[0].path}' have colliders, which are shapes of the model and cannot move or change in "
        "number; set TrainingSpec(obstacles=ObstaclesCfg(...)), or ObstaclesCfg(of_scenery=True) in the scene's config"
    )


def _write_material(model: newton.Model, shape: int, terrain: TerrainImporter) -> None:
    """Give the ground its friction and restitution."""
    material = terrain.cfg.physics_material
    if material is None:
        return
    for name, value in (
        ("shape_material_mu", material.dynamic_friction),
        ("shape_material_restitution", material.restitution),
    ):
        getattr(model, name)[shape : shape + 1].fill_(float(value))


def _paths(made: Usd.Stage) -> list[Sdf.Path]:
    """Prims that a specification makes below ``/World``."""
    return [child.path for child in made.GetRootLayer().GetPrimAtPath("/World").nameChildren]


def _swap(stage: Usd.Stage, old: list[Sdf.Path], new: Usd.Stage) -> None:
    """Put the prims of a new scene in the place of those of the old one.

    Args:
        stage: The stage.
        old: Prims of the old scene.
        new: Stage of the new scene alone.

    Raises:
        ValueError: if the stage has something else where the new scene has something.
    """
    target, source = stage.GetRootLayer(), new.GetRootLayer()
    children = _paths(new)
    for path in children:
        if path not in old and target.GetPrimAtPath(path):
            raise ValueError(f"'{path}': the stage has it already, and the new scene has it too")
    # On layers, in one block: through the stage, USD would compose thousands of prims after every change.
    edit = Sdf.BatchNamespaceEdit()
    for path in [*old, Sdf.Path("/Prototypes")]:
        if target.GetPrimAtPath(path):
            edit.Add(path, Sdf.Path.emptyPath)
    with Sdf.ChangeBlock():
        target.Apply(edit)
        for path in [*children, Sdf.Path("/Prototypes")]:
            Sdf.CopySpec(source, path, target, path)
