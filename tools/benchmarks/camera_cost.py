# SPDX-License-Identifier: Apache-2.0
"""Cost of a camera's pictures by part: placing shapes, rays, shading, shadows, writing, and the observation.

    python tools/benchmarks/camera_cost.py --case cart-poles --out cart_poles.json      # 64 x 64 RGB, 4096 environments
    python tools/benchmarks/camera_cost.py --case quadrupeds --out quadrupeds.json      # 64 x 48 depth on rough ground
    python tools/benchmarks/camera_cost.py --case lift --mesh-detail 0                  # a Panda with all its triangles
    python tools/benchmarks/camera_cost.py --case cart-poles --newton                   # Newton's sensor beside it

Kernels are timed as a replayed graph of ten launches. A part is the difference between two kernels: shading is colour
less depth, a shadow is colour with shadows less colour. Writing is a fill of the image. ``step`` is a whole step of the
environment under random actions.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium
import torch
import warp as wp

import stripe_tasks  # noqa: F401  (registers the tasks)
from stripe_newton.cli.tasks import load_cfg
from stripe_newton.envs import RLEnv
from stripe_newton.envs.measure import random_actions
from stripe_newton.sensors import Camera
from stripe_newton.sensors.camera_renderer import CameraImages, CameraRenderer
from stripe_newton.sensors.newton_renderer import NewtonRenderer

CASES = {
    "cart-poles": ("Stripe-Cartpole-Camera-Direct-v0", "tiled_camera", "camera"),
    "lift": ("Stripe-Lift-Cube-Panda-Camera-v0", "scene.tiled_camera", "tiled_camera"),
    "quadrupeds": ("Stripe-Velocity-Rough-Quadruped-Depth-v0", "scene.depth_camera", "depth_camera"),
}
"""By case: the task, where its config has the camera, and the camera's name in the scene."""
LAUNCHES, REPLAYS = 10, 10


def make(args: argparse.Namespace) -> tuple[RLEnv, Camera]:
    """The environment of a case, after a few steps. Its camera renders in every step, without noise or delay."""
    task, where, name = CASES[args.case]
    cfg = load_cfg(task, "env")
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = args.device, args.num_envs, 1
    camera = cfg
    for field in where.split("."):
        camera = getattr(camera, field)
    camera.update_period, camera.noise, camera.delay, camera.renderer = 0.0, None, 0, args.renderer
    camera.mesh_detail = args.mesh_detail
    if args.size:
        camera.width, camera.height = args.size
        if args.case == "cart-poles":
            cfg.observation_space = [3, camera.height, camera.width]
    env = gymnasium.make_vec(task, cfg=cfg).unwrapped
    env.reset(seed=1)
    actions = random_actions(env, 16)
    for index in range(24):
        env.step(actions[index % 16])
    return env, env.scene[name]


def wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def time_launches(launch: Callable[[], object], device: str) -> float:
    """Milliseconds of what a function launches: on a GPU within a graph, the least of some replays' means."""
    launch()  # modules are loaded before the capture
    if device == "cpu":
        start = time.perf_counter()
        launch()
        return 1e3 * (time.perf_counter() - start)
    with wp.ScopedDevice(device):
        with wp.ScopedCapture() as capture:
            for _ in range(LAUNCHES):
                launch()
        first, last, found = wp.Event(enable_timing=True), wp.Event(enable_timing=True), []
        for _ in range(REPLAYS):
            wp.record_event(first)
            wp.capture_launch(capture.graph)
            wp.record_event(last)
            found.append(wp.get_event_elapsed_time(first, last) / LAUNCHES)
    return min(found)


def images_of(camera: Camera, *names: str) -> CameraImages:
    """Images of a camera's size, of the names alone."""
    shape, device = (camera.num_envs, camera.cfg.height, camera.cfg.width), camera.device
    kinds = {"color": wp.uint32, "plane": float, "length": float, "normals": wp.vec3, "shape": wp.uint32}
    made = {n: wp.zeros(shape if n in names else (0, 0, 0), dtype=t, device=device) for n, t in kinds.items()}
    return CameraImages(**made)


def own_parts(camera: Camera, device: str) -> dict[str, float]:
    """Milliseconds of the parts of the package's renderer."""
    renderer = camera.renderer
    assert isinstance(renderer, CameraRenderer)
    due = wp.full(camera.num_envs, value=True, dtype=wp.bool, device=device)
    pose = camera.poses_opengl
    found = {"place": time_launches(lambda: renderer.place(due, pose), device)}
    colored = renderer.features.color
    kernels = {"depth": (("plane",), False), "normals": (("normals",), False)}
    kernels |= {"color": (("color",), False), "color_shadows": (("color",), True)} if colored else {}
    total = {}
    for name, (wanted, shadows) in kernels.items():
        other = renderer.variant(images_of(camera, *wanted), shadows)
        total[name] = time_launches(lambda other=other: other.launch(due, pose), device)
    found |= {f"all_{name}": value for name, value in total.items()}
    found["rays"] = total["depth"] - found["place"]
    image = images_of(camera, "color" if colored else "plane")
    filled = image.color if colored else image.plane
    found["writing"] = time_launches(lambda: filled.fill_(1), device)
    if colored:
        found["shading"] = total["color"] - total["depth"]
        found["shadows"] = total["color_shadows"] - total["color"]
    return found


def newton_parts(env: RLEnv, camera: Camera, device: str) -> dict[str, float]:
    """Milliseconds of Newton's sensor, refit of its tree included."""
    cfg, found = camera.cfg, {}
    due = wp.full(camera.num_envs, value=True, dtype=wp.bool, device=device)
    colors = camera.colors
    for name in ("plane", "color") if colors is not None else ("plane",):
        images = images_of(camera, name)
        if colors is not None:
            images.color = colors.color if name == "color" else images.color
        other = NewtonRenderer(
            env.sim, cfg.spawn, cfg.spawn.clipping_range, images, colors if name == "color" else None, 0.0, False
        )
        found[f"newton_{name}"] = time_launches(lambda other=other: other.launch(due, camera.poses_opengl), device)
    found["newton_refit"] = time_launches(lambda: env.sim.model.bvh_refit_shapes(env.sim.state), device)
    return found


def time_steps(env: RLEnv, steps: int, device: str) -> float:
    """Milliseconds of a step under random actions."""
    actions = random_actions(env, 16)
    for index in range(8):
        env.step(actions[index % 16])
    wait(device)
    start = time.perf_counter()
    for index in range(steps):
        env.step(actions[index % 16])
    wait(device)
    return 1e3 * (time.perf_counter() - start) / steps


def measure(args: argparse.Namespace) -> dict[str, object]:
    env, camera = make(args)
    parts = {
        "step": time_steps(env, args.steps, args.device),
        "camera": time_launches(camera.launch_observed, args.device),
    }
    parts |= own_parts(camera, args.device) if isinstance(camera.renderer, CameraRenderer) else {}
    parts |= newton_parts(env, camera, args.device) if args.newton else {}
    if args.case == "cart-poles":
        parts["observation"] = time_launches(env._launch_observations, args.device)
    device = args.device if args.device == "cpu" else torch.cuda.get_device_name(args.device)
    rates = {name: round(1e3 * args.num_envs / parts[name]) for name in ("step", "camera")}
    env.close()
    return {
        "case": args.case,
        "device": device,
        "num_envs": args.num_envs,
        "camera": camera.describe(),
        "ms": {name: round(value, 4) for name, value in parts.items()},
        "pictures_per_s": rates,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=list(CASES), required=True)
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument(
        "--size", type=int, nargs=2, metavar=("WIDTH", "HEIGHT"), help="of the picture; default the task's"
    )
    parser.add_argument("--mesh-detail", type=float, default=0.5, help="as in the camera's config [px]")
    parser.add_argument("--renderer", choices=("auto", "newton"), default="auto", help="that the step uses")
    parser.add_argument(
        "--newton", action="store_true", help="time Newton's sensor too, whose kernels take long to compile"
    )
    parser.add_argument("--steps", type=int, default=200, help="steps of the environment that are timed")
    parser.add_argument("--device", default="cuda:0" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--out", type=Path, help="file for the JSON")
    args = parser.parse_args()
    found = measure(args)
    text = json.dumps(found, indent=1)
    print(text)
    if args.out:
        args.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
