# SPDX-License-Identifier: Apache-2.0
"""Pictures of the README: ``python tools/pictures/make_pictures.py [docs/images]``.

``hero.jpg`` shows running ants and humanoids, ``pack.jpg`` quadrupeds on generated ground, and ``cartpole.png`` and so
on one environment of each task. No training is needed: robots are posed, and those of the pack stand by themselves.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import gymnasium
import newton
import numpy as np
import torch
import warp as wp
from PIL import Image

import stripe_tasks  # noqa: F401 (registers the tasks)
from stripe_newton.assets import Articulation, AssetBaseCfg
from stripe_newton.configclass import resolve_name
from stripe_newton.math import quat_apply, quat_from_euler_xyz
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    DistantLightCfg,
    DomeLightCfg,
    GroundPlaneCfg,
    Simulation,
    SimulationCfg,
)
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_tasks.robots import ANT_CFG, HUMANOID_CFG

OVERSAMPLING = 2
"""Rays along each side of a pixel."""


def save(path: Path, renderer: SceneRenderer) -> None:
    """Render, scale down to the requested size, and write a small PNG or JPEG."""
    picture = Image.fromarray(renderer.render())
    size = (picture.width // OVERSAMPLING, picture.height // OVERSAMPLING)
    picture = picture.resize(size, Image.Resampling.BOX)
    if path.suffix == ".jpg":
        picture.save(path, quality=84, optimize=True)
    else:
        picture.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1024} kB")


def viewer(width: int, height: int, **options: object) -> ViewerCfg:
    """A camera whose picture is scaled down to the given size later."""
    resolution = (width * OVERSAMPLING, height * OVERSAMPLING)
    return ViewerCfg(resolution=resolution, shadow_resolution=2048, **options)  # type: ignore[arg-type]


def ant_pose(phase: float) -> dict[str, float]:
    """Joint angles [rad] of an ant at a trot: diagonal legs move together."""
    legs = {"front_left": (0.0, 1), "front_right": (math.pi, -1), "left_back": (math.pi, -1), "right_back": (0.0, 1)}
    pose = {}
    for leg, (offset, side) in legs.items():
        swing = math.sin(phase + offset)
        lift = max(0.0, math.cos(phase + offset))
        pose[f"{leg}_leg"] = 0.5 * swing
        pose[f"{leg}_foot"] = side * (1.0 - 0.42 * lift)
    return pose


def humanoid_pose(phase: float) -> dict[str, float]:
    """Joint angles [rad] of a humanoid at a run."""
    pose = {"lower_waist:1": -0.12}
    for side, offset in (("left", 0.0), ("right", math.pi)):
        swing, lift = math.sin(phase + offset), math.cos(phase + offset)
        pose[f"{side}_thigh:1"] = -0.35 - 0.75 * swing
        pose[f"{side}_knee"] = -0.75 - 0.65 * lift
        pose[f"{side}_foot:1"] = 0.15
        pose[f"{side}_upper_arm:0"] = 0.25 * swing * (1 if side == "left" else -1)
        pose[f"{side}_elbow"] = -0.9
    return pose


def put(
    sim: Simulation,
    robot: Articulation,
    pose: dict[str, float],
    at: tuple[float, float],
    yaw: float,
    pitch: float = 0.0,
) -> None:
    """Put a robot into a pose, with its lowest point on the ground."""
    joints = robot.data.default_joint_pos.clone()
    for name, angle in pose.items():
        joints[:, robot.find_joints(name)[0]] = angle
    robot.write_joint_state_to_sim(joints, torch.zeros_like(joints))
    angles = torch.tensor([0.0, pitch, yaw]).unbind()
    quat = quat_from_euler_xyz(*(a.view(1) for a in angles))
    root = torch.cat((torch.tensor([[*at, 5.0]]), quat), dim=-1)
    robot.write_root_pose_to_sim(root)
    sim.forward()
    root[:, 2] -= lowest(sim, robot)
    robot.write_root_pose_to_sim(root)
    sim.forward()


def lowest(sim: Simulation, robot: Articulation) -> float:
    """Height of the lowest point of a robot made of spheres and capsules [m]."""
    builder, heights = sim.template, []
    poses = wp.to_torch(sim.state.body_q)
    for shape, body in enumerate(builder.shape_body):
        if body not in robot.layout.bodies or not builder.shape_flags[shape] & newton.ShapeFlags.COLLIDE_SHAPES:
            continue
        local = torch.tensor([list(builder.shape_transform[shape])])
        radius, half = (float(x) for x in builder.shape_scale[shape][:2])
        half = half if builder.shape_type[shape] == newton.GeoType.CAPSULE else 0.0
        for end in (-half, half):
            point = quat_apply(local[:, 3:], torch.tensor([[0.0, 0.0, end]])) + local[:, :3]
            heights.append(
                float((quat_apply(poses[body : body + 1, 3:], point) + poses[body : body + 1, :3])[0, 2]) - radius
            )
    return min(heights)


def hero(path: Path) -> None:
    """A herd of ants and humanoids."""
    rng = np.random.default_rng(4)
    people = [(0.6, 0.9), (-1.6, -2.0), (-2.9, 2.9), (-5.2, 0.3), (-5.9, 5.6), (-6.6, -3.4), (-9.0, 2.6)]
    people += [(-12.5, -0.6), (-12.0, 6.6)]
    herd = [(1.4, -1.1), (0.1, -3.8), (0.9, 3.0), (-1.7, 0.7), (-1.3, 4.9), (-3.6, -4.0), (-3.9, -0.9), (-4.6, 2.6)]
    herd += [(-3.9, 7.3), (-6.9, 8.4), (-7.3, 1.8), (-7.2, -0.9), (-7.6, 4.6), (-9.6, 0.2), (-9.9, 5.6), (-9.8, -2.6)]
    herd += [(-10.6, 8.6), (-12.4, 2.2), (-12.7, 4.3), (-13.6, 9.2), (-15.4, 1.6), (-15.9, 5.6)]
    places = [("humanoid", *at) for at in people] + [("ant", *at) for at in herd]
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(SimulationCfg(device="cpu")))
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    dome = AssetBaseCfg(prim_path="/World/dome", spawn=DomeLightCfg(intensity=1500.0, color=(0.8, 0.88, 1.0)))
    sun = AssetBaseCfg(prim_path="/World/sun", spawn=DistantLightCfg(intensity=3000.0, color=(1.0, 0.93, 0.82)))
    sun.init_state.rot = (0.20, 0.42, 0.0, 0.885)
    scene.builder.build_objects({"ground": ground, "dome": dome, "sun": sun})
    for i, (kind, x, y) in enumerate(places):
        cfg = {"ant": ANT_CFG, "humanoid": HUMANOID_CFG}[kind].replace(prim_path=f"{{ENV_REGEX_NS}}/Robot_{i}")
        cfg.init_state.pos = (x, y, 1.5)  # apart from each other: the solver looks for contacts when it is made
        scene.builder.build_robot(f"robot_{i}", cfg)
    scene.build()
    for i, (kind, x, y) in enumerate(places):
        at = x + rng.uniform(-0.15, 0.15), y + rng.uniform(-0.15, 0.15)
        phase, yaw = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.25, 0.25)
        if kind == "ant":
            put(scene.sim, scene[f"robot_{i}"], ant_pose(phase), at, yaw)
        else:
            put(scene.sim, scene[f"robot_{i}"], humanoid_pose(phase), at, yaw, 0.12)
    renderer = SceneRenderer(scene.sim, viewer(1280, 640, eye=(7.2, -6.0, 2.3), lookat=(-2.2, 0.75, 0.45), fov=25.0))
    save(path, renderer)


def task(path: Path, name: str, **camera: object) -> None:
    """One environment of a task."""
    cfg = resolve_name(gymnasium.spec(name).kwargs["env_cfg_entry_point"])()
    cfg.scene.num_envs, cfg.sim.device = 1, "cpu"
    env = gymnasium.make_vec(name, cfg=cfg)
    env.reset(seed=1)
    robot = env.unwrapped.robot
    if "Ant" in name:
        put(env.unwrapped.sim, robot, ant_pose(2.4), (0.0, 0.0), 0.0)
    elif "Humanoid" in name:
        put(env.unwrapped.sim, robot, humanoid_pose(1.0), (0.0, 0.0), 0.0, 0.12)
    else:
        joints = torch.tensor([[0.5, -0.22] if robot.num_joints == 2 else [0.4, -0.16, 0.38]])
        robot.write_joint_state_to_sim(joints, torch.zeros_like(joints))
        env.unwrapped.sim.forward()
    save(path, SceneRenderer(env.unwrapped.sim, viewer(480, 480, **camera)))
    env.close()


def pack(path: Path) -> None:
    """Quadrupeds on blocks, stairs and slopes."""
    name = "Stripe-Velocity-Rough-Quadruped-v0"
    cfg = resolve_name(gymnasium.spec(name).kwargs["env_cfg_entry_point"])()
    places = [(0.3, -1.1), (-1.2, 0.6), (1.5, 0.9), (-0.7, -2.9), (-2.5, -0.6), (-3.4, 1.9), (-5.4, 0.1), (-1.0, 3.2)]
    places += [(-5.6, 3.6), (-7.9, 1.6), (-3.6, 5.4), (-8.4, 4.9), (-6.1, -2.6), (-10.9, 3.1), (-11.6, 6.4)]
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = len(places), "cpu", 2
    tiles = cfg.scene.terrain.terrain_generator
    tiles.num_rows, tiles.num_cols, tiles.border_width, tiles.size = 4, 4, 8.0, (5.0, 5.0)
    for name_, share in zip(tiles.sub_terrains, (1.0, 0.6, 1.2, 0.9, 0.6, 0.3), strict=True):
        tiles.sub_terrains[name_].proportion = share
        if hasattr(tiles.sub_terrains[name_], "platform_width"):
            tiles.sub_terrains[name_].platform_width = 1.2
    env = gymnasium.make_vec(name, cfg=cfg).unwrapped
    env.reset(seed=2)
    rng, robot = np.random.default_rng(3), env.scene["robot"]
    pose = robot.data.root_pose_w.clone()
    for i, (x, y) in enumerate(places):
        turn = quat_from_euler_xyz(*torch.tensor([[0.0], [0.0], [rng.uniform(-0.5, 0.5)]]))
        near = np.meshgrid(x + np.linspace(-0.3, 0.3, 7), y + np.linspace(-0.2, 0.2, 5))
        top = env.scene.terrain.ground.height_at(*near).max()
        pose[i] = torch.cat((torch.tensor([x, y, top + 0.34]), turn[0]))
    robot.write_root_pose_to_sim(pose)
    actions = torch.zeros(len(places), 12)
    for _ in range(35):
        env.step(actions)
    camera = viewer(1280, 560, eye=(4.4, -4.2, 1.7), lookat=(-2.3, 1.0, 0.05), fov=24.0, origin_type="world")
    save(path, SceneRenderer(env.sim, camera, range(len(places))))
    env.close()


def snapshot(path: Path, name: str, steps: int = 12, **camera: object) -> None:
    """One environment of a task a moment after it began, by its own camera or another."""
    cfg = resolve_name(gymnasium.spec(name).kwargs["env_cfg_entry_point"])()
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = 1, "cpu", 3
    size = {"resolution": (480 * OVERSAMPLING, 360 * OVERSAMPLING), "shadow_resolution": 2048}
    cfg.viewer = cfg.viewer.replace(**size, **camera)
    env = gymnasium.make_vec(name, cfg=cfg, render_mode="rgb_array")
    env.reset(seed=3)
    for _ in range(steps):
        env.step(torch.zeros(1, *env.unwrapped.single_action_space.shape))
    frame = env.render()
    picture = Image.fromarray(frame[0] if isinstance(frame, (list, tuple)) else frame)
    picture.resize((480, 360), Image.Resampling.BOX).save(path, optimize=True)
    env.close()


def main() -> None:
    """Draw all pictures."""
    wp.config.log_level = wp.LOG_WARNING
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")
    out.mkdir(parents=True, exist_ok=True)
    hero(out / "hero.jpg")
    pack(out / "pack.jpg")
    task(out / "cartpole.png", "Stripe-Cartpole-Direct-v0", eye=(3.3, -1.2, 2.75), lookat=(0.0, 0.45, 2.35), fov=30.0)
    task(
        out / "cart_double_pole.png",
        "Stripe-CartDoublePole-Direct-v0",
        eye=(5.0, -1.9, 3.4),
        lookat=(0.0, 0.3, 2.85),
        fov=30.0,
    )
    snapshot(out / "reach.png", "Stripe-Reach-v0")
    snapshot(out / "quadcopter.png", "Stripe-Quadcopter-Direct-v0", fov=16.0)
    snapshot(out / "push_ball.png", "Stripe-PushBall-Ant-v0", eye=(-2.2, -4.6, 2.2), lookat=(1.5, 0.3, 0.2), fov=36.0)
    task(out / "ant.png", "Stripe-Ant-Direct-v0", azimuth=-40.0)
    task(out / "humanoid.png", "Stripe-Humanoid-Direct-v0", azimuth=-35.0)


if __name__ == "__main__":
    main()
