# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton scene simulate``: simulates a scene of a specification, walks through it and drops things into it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch

from .live_view import check_installed, open_viewer
from .progress import Progress

if TYPE_CHECKING:
    from stripe_newton.envs import LabScene
    from stripe_newton.specifications import Scene, SceneSpec
    from stripe_newton.viewers import ViewerCfg

__all__ = ["Options", "simulate"]

_FPS = 30
_SPEED = 1.2
"""Speed of the walk [m/s]."""
_EYE_HEIGHT = 1.6
_FEW = 300
"""Assets up to which each collider is a shape of the model, which is exact; beyond, things touch the nearest ones."""
_KINDS = ("box", "ball", "rod")
_RADIUS = 0.15
"""Size of the things [m]."""
_SLOTS, _REACH = 12, 0.6
"""Nearest obstacles that a thing may touch, and how far they may be: twice the size of a rod [m]."""


@dataclass
class Options:
    """Options of the command, checked."""

    seed: int
    places: int
    """Places at which things are dropped."""
    seconds: float
    viewer: Literal["viser", "video", "none"]
    out: Path
    """The video."""
    resolution: tuple[int, int]
    host: str
    port: int
    """Where the live view listens."""
    device: str | None


def simulate(name: str, spec: SceneSpec, options: Options) -> None:
    """Simulate a scene, show it, and print what became of the things.

    Raises:
        UserError: for a viewer that is not installed, or that cannot listen there.
    """
    if options.viewer == "viser":
        check_installed()
    with Progress() as progress:
        progress.step("create", f"scene {name}, seed {options.seed}")
        scene = spec.create(options.seed)
        progress.step("model", "model and solver (kernels are compiled the first time)")
        lab = _build(spec, scene, options)
        try:
            walk = _Walk(scene, lab, options)
            walk.drop()
            if options.viewer == "viser":
                progress.finish()
                _watch(f"scene {name}", lab, walk, options)
            else:
                progress.step("simulate", f"{options.seconds:g} s")
                walk.run()
            report = walk.report()
        finally:
            lab.close()
    report += [(f"seconds: {phase}", f"{took:.1f}") for phase, took in progress.seconds.items()]
    width = max(len(row) for row, _ in report) + 2
    print("\n".join(f"{row:<{width}}{value}" for row, value in report))
    if options.viewer == "video":
        print(options.out)


def _build(spec: SceneSpec, scene: Scene, options: Options) -> LabScene:
    """The scene with a box, a ball and a rod for each place. Each place is an environment; all share the scene."""
    from stripe_newton.assets import RigidObjectCfg
    from stripe_newton.envs import LabScene
    from stripe_newton.scene import ObstaclesCfg
    from stripe_newton.sim import (
        CapsuleCfg,
        CollisionPropertiesCfg,
        CuboidCfg,
        MassPropertiesCfg,
        PreviewSurfaceCfg,
        RigidBodyPropertiesCfg,
        SimulationCfg,
        SphereCfg,
    )

    shapes = {
        "box": CuboidCfg(size=(2 * _RADIUS,) * 3),
        "ball": SphereCfg(radius=_RADIUS),
        "rod": CapsuleCfg(radius=0.4 * _RADIUS, height=3.0 * _RADIUS),
    }
    colors = {"box": (0.85, 0.25, 0.05), "ball": (0.05, 0.3, 0.8), "rod": (0.9, 0.7, 0.05)}
    factory = spec.create_instance(max(options.places, 1), 0.0, seed=options.seed)
    for kind in _KINDS:
        shape = shapes[kind].replace(
            rigid_props=RigidBodyPropertiesCfg(),
            collision_props=CollisionPropertiesCfg(),
            mass_props=MassPropertiesCfg(mass=1.0),
            visual_material=PreviewSurfaceCfg(diffuse_color=colors[kind]),
        )
        path = f"{{ENV_REGEX_NS}}/{kind.capitalize()}"
        factory.add_asset(kind, RigidObjectCfg(prim_path=path, spawn=shape))
        if len(scene.instances) > _FEW and _are_capsules(scene):
            near = ObstaclesCfg(
                prim_path=f"/World/near_{kind}", of_scenery=True, asset_name=kind, slots=_SLOTS, reach=_REACH
            )
            factory.add_sensor(f"near_{kind}", near)
    # Where more obstacles crowd together than there are slots, a thing may sink in; that is no reason to end.
    sim = SimulationCfg(dt=1.0 / 240.0, device=options.device, on_overflow="warn")
    return LabScene(factory.get_scene(), sim=sim, decimation=round(240 / _FPS))


def _are_capsules(scene: Scene) -> bool:
    meshes = {id(instance.mesh): instance.mesh for instance in scene.instances}
    return all(c.kind in ("capsule", "sphere") for mesh in meshes.values() for c in mesh.colliders())


class _Walk:
    """A walk through a scene at eye level, past things that fall."""

    def __init__(self, scene: Scene, lab: LabScene, options: Options):
        from stripe_newton.specifications.scene_pictures import ScenePictures

        self._scene, self._lab, self._options = scene, lab, options
        self._ground = scene.terrain.ground
        eye, target = ScenePictures(scene, (64, 36), lab.device).view()
        self._start = np.asarray(eye[:2], dtype=float)
        ahead = np.asarray(target[:2], dtype=float) - self._start
        self._ahead = ahead / max(float(np.linalg.norm(ahead)), 1.0e-6)

    def drop(self) -> None:
        """Put the things over the ground ahead, in two rows beside the way."""
        lab, count = self._lab, self._lab.num_envs
        across = np.array([-self._ahead[1], self._ahead[0]])
        row, side = np.arange(count) // 2, np.where(np.arange(count) % 2, 1.0, -1.0)
        way = np.minimum(4.0 + 1.2 * row, 0.45 * min(self._scene.terrain.size))
        spots = self._start + way[:, None] * self._ahead + (0.9 * side)[:, None] * across
        inside = np.array(self._ground.lower)[None], np.array(self._ground.lower) + self._ground.size
        spots = np.clip(spots, inside[0] + 0.5, inside[1] - 0.5)
        height = np.asarray(self._ground.height_at(spots[:, 0], spots[:, 1]))
        lab.reset(seed=self._options.seed)
        for index, kind in enumerate(_KINDS):
            pose = torch.zeros(count, 7, device=lab.device)
            pose[:, 6] = 1.0
            pose[:, :2] = torch.as_tensor(spots, dtype=torch.float32) + 0.1 * index
            pose[:, 2] = torch.as_tensor(height + 1.5 + 1.0 * index + 0.2 * row, dtype=torch.float32)
            lab.scene[kind].write_root_pose_to_sim(pose)

    def run(self) -> None:
        """Simulate, with a video where it is wanted."""
        from stripe_newton.viewers import VideoWriter

        frames = math.ceil(self._options.seconds * _FPS)
        if self._options.viewer == "none":
            for _ in range(frames):
                self._lab.step()
            return
        with VideoWriter(self._options.out, _FPS) as video:
            for picture in self._pictures(frames):
                video.add(picture)

    def _pictures(self, frames: int) -> Iterator[np.ndarray]:
        from stripe_newton.viewers import SceneRenderer, ViewerCfg

        cfg = ViewerCfg(resolution=self._options.resolution, origin_type="world", eye=(0, 0, 1), lookat=(1, 0, 1))
        renderer = SceneRenderer(self._lab.sim, cfg, range(self._lab.num_envs))
        height = self._eye(0.0)[2]
        for frame in range(frames):
            self._lab.step()
            eye = self._eye(frame / _FPS)
            height += 0.15 * (eye[2] - height)  # steps of the ground do not shake the view
            eye[2] = height
            target = [eye[0] + 6.0 * self._ahead[0], eye[1] + 6.0 * self._ahead[1], height - 1.6]
            renderer.look(eye.tolist(), target)
            yield renderer.render()
        renderer.close()

    def first_view(self) -> ViewerCfg:
        """The view with which the walk begins."""
        from stripe_newton.viewers import ViewerCfg

        eye = self._eye(0.0)
        target = [eye[0] + 6.0 * self._ahead[0], eye[1] + 6.0 * self._ahead[1], eye[2] - 0.6]
        return ViewerCfg(
            origin_type="world", eye=(eye[0], eye[1], eye[2]), lookat=(target[0], target[1], target[2]), fov=50.0
        )

    def _eye(self, seconds: float) -> np.ndarray:
        """Position of the eye [m]: it walks for half of the time and then stands."""
        way = _SPEED * min(seconds, 0.5 * self._options.seconds)
        spot = self._start + min(way, 0.4 * min(self._scene.terrain.size)) * self._ahead
        return np.array([*spot, float(self._ground.height_at(spot[:1], spot[1:])[0]) + _EYE_HEIGHT])

    def report(self) -> list[tuple[str, str]]:
        """Rows about the scene, and about how many things lie still, left the scene, and are below its ground."""
        lab, resting, below, away = self._lab, 0, 0, 0
        lower = np.array(self._ground.lower)
        for kind in _KINDS:
            data = lab.scene[kind].data
            position = data.root_pos_w.cpu().numpy()
            ground = self._ground.height_at(position[:, 0], position[:, 1])
            is_outside = ((position[:, :2] < lower) | (position[:, :2] > lower + self._ground.size)).any(axis=1)
            resting += int((data.root_lin_vel_w.norm(dim=1).cpu().numpy()[~is_outside] < 0.1).sum())
            below += int((position[:, 2] < ground - _RADIUS)[~is_outside].sum())
            away += int(is_outside.sum())
        count = len(_KINDS) * lab.num_envs
        return [
            ("size", f"{self._scene.terrain.size[0]:g} x {self._scene.terrain.size[1]:g} m"),
            ("assets", f"{len(self._scene.instances):,}"),
            ("physics", lab.sim.describe_solver()),
            (
                "things",
                f"{count} dropped at {lab.num_envs} places: {resting} at rest, {away} over the edge, "
                f"{below} below the ground",
            ),
        ]


def _watch(title: str, lab: LabScene, walk: _Walk, options: Options) -> None:
    """Show the scene live, in real time, for so many seconds or until Ctrl-C."""
    limit = None if math.isinf(options.seconds) else math.ceil(options.seconds * _FPS)
    with open_viewer(lab, title, options.host, options.port, cfg=walk.first_view(), reset=walk.drop) as viewer:
        try:
            for _ in viewer.steps(limit):
                lab.step()
        except KeyboardInterrupt:
            print()
