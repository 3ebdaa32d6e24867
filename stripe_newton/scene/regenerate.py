# SPDX-License-Identifier: Apache-2.0
"""Another scene of the same specification in a scene that is built: all in place, so that graphs go on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pxr import Sdf, Usd

from stripe_newton.sim.height_field import replace_heights
from stripe_newton.terrains.ground_usd import ground_prims, placement, read_ground

from .scenery import Scenery, read_scenery

if TYPE_CHECKING:
    from .interactive_scene import InteractiveScene

__all__ = ["obstacle_to_regenerating", "regenerate_scene", "scene_spawner"]


def scene_spawner(scene: InteractiveScene) -> Any:
    """Config of the spawner that makes a scene from a specification or a file of one; None if there is none."""
    for name in type(scene.cfg).__dataclass_fields__:
        spawn = getattr(getattr(scene.cfg, name), "spawn", None)
        if hasattr(spawn, "made") and hasattr(spawn, "seed"):
            return spawn
    return None


def obstacle_to_regenerating(scene: InteractiveScene) -> str:
    """What keeps a scene from being made anew, and what to do about it; empty if nothing does."""
    from stripe_newton.sensors.camera import Camera

    spawn = scene_spawner(scene)
    if spawn is None:
        return "the scene is of no specification: make its config by SceneSpec.create_instance() or TrainingSpec"
    if spawn.spec is None:
        return f"the scene is of the file '{spawn.usd_path}', of which there is no other; give its specification"
    if not scene.built:
        return "the scene is not built yet: set the seed in its config"
    for name, sensor in scene.sensors.items():
        if isinstance(sensor, Camera):
            return f"the camera '{name}' sees the meshes of the scene as they were built; leave it out"
        if hasattr(sensor, "meets") and sensor.meets(_ground_shape(scene)) == "tree":
            return f"the rays of '{name}' meet the ground as a mesh; leave other height fields out of the scene"
    fixed = [label for label, body in _shapes(scene.sim.template) if body < 0]
    if fixed:
        return (
            f"'{fixed[0]}' is fixed to the world in each environment, at the height of the ground that was there; "
            "give it a body, or leave it out"
        )
    return "" if scene.builder.takers else _colliders(read_scenery(scene.stage), scene)


def _shapes(builder: Any) -> list[tuple[str, int]]:
    return list(zip(builder.shape_label, builder.shape_body, strict=True))


def _ground_shape(scene: InteractiveScene) -> int:
    return list(scene.sim.model.shape_label).index(f"{scene.terrain.path}/terrain")


def _colliders(scenery: Scenery, scene: InteractiveScene) -> str:
    touched = [p for i, p in enumerate(scenery.prototypes) if p.shapes and (scenery.which == i).any()]
    if not touched or scene.builder.takers:
        return ""
    return (
        f"assets like '{touched[0].path}' have colliders, which are shapes of the model and cannot move or change in "
        "number; set TrainingSpec(obstacles=ObstaclesCfg(...)), or ObstaclesCfg(of_scenery=True) in the scene's config"
    )


def regenerate_scene(scene: InteractiveScene, seed: int) -> None:
    """See :meth:`InteractiveScene.regenerate`. Everything is checked before anything is written."""
    if problem := obstacle_to_regenerating(scene):
        raise ValueError(f"regenerate: {problem}")
    spawn = scene_spawner(scene)
    if not scene.scenery_paths:
        scene.scenery_paths = _paths(spawn.made().stage)
    new = spawn.replace(seed=seed).made().stage
    (prim,) = ground_prims(new)
    terrain, ground, scenery = scene.terrain, read_ground(prim), read_scenery(new)
    try:
        terrain.check(ground)
        if problem := _colliders(scenery, scene):
            raise ValueError(problem)
        capsules = scenery.capsules() if scene.builder.takers else None
        for obstacles in scene.builder.takers:
            obstacles.check(capsules)
        _swap(scene.stage, scene.scenery_paths, new)
    except ValueError as error:
        raise ValueError(f"regenerate: seed {seed}: {error}") from error
    for name, value in placement(prim).items():
        setattr(terrain.cfg, name, value)
    terrain.replace(ground)
    _surface(scene, _ground_shape(scene))
    replace_heights(scene.sim, _ground_shape(scene), ground.source)
    for sensor in scene.sensors.values():
        if hasattr(sensor, "meets") and sensor.meets(_ground_shape(scene)):
            sensor.replace_field(ground.heights)
    for obstacles in scene.builder.takers:
        obstacles.replace(capsules)
    scene.builder.rebuild_shared(scenery)
    scene.scenery_seed, scene.scenery_paths = seed, _paths(new)


def _surface(scene: InteractiveScene, shape: int) -> None:
    """Give the ground its friction and restitution."""
    material, model = scene.terrain.cfg.physics_material, scene.sim.model
    if material is None:
        return
    for name, value in (
        ("shape_material_mu", material.dynamic_friction),
        ("shape_material_restitution", material.restitution),
    ):
        getattr(model, name)[shape : shape + 1].fill_(float(value))


def _paths(made: Usd.Stage) -> list[Sdf.Path]:
    """What a specification makes below ``/World``."""
    return [child.path for child in made.GetRootLayer().GetPrimAtPath("/World").nameChildren]


def _swap(stage: Usd.Stage, mine: list[Sdf.Path], new: Usd.Stage) -> None:
    """Put the prims of one scene in the place of those of another, which are ``mine``.

    Raises:
        ValueError: if the stage has something else where the new scene has something.
    """
    target, source = stage.GetRootLayer(), new.GetRootLayer()
    children = _paths(new)
    for path in children:
        if path not in mine and target.GetPrimAtPath(path):
            raise ValueError(f"'{path}': the stage has it already, and the new scene has it too")
    edit = Sdf.BatchNamespaceEdit()
    for path in [*mine, Sdf.Path("/Prototypes")]:
        if target.GetPrimAtPath(path):
            edit.Add(path, Sdf.Path.emptyPath)
    with Sdf.ChangeBlock():
        target.Apply(edit)
        for path in [*children, Sdf.Path("/Prototypes")]:
            Sdf.CopySpec(source, path, target, path)
