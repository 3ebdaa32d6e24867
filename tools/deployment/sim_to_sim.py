# SPDX-License-Identifier: Apache-2.0
"""Sim to sim: measure a trained policy in plain MuJoCo, on the CPU.

    python tools/deployment/sim_to_sim.py TASK RUN [--spread 0.2] [--episodes 20] [--seconds 20] [--seed 0] [--out DIR]

It does in one go what ``stripe-newton export RUN --mjcf`` and ``tools/deployment/deploy_mujoco.py`` do. With --out it
also films the first episode.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

if sys.platform == "linux" and not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported; draws without a window
import mujoco

sys.path.insert(0, str(Path(__file__).parent))
import deploy_mujoco


def camera_on(robot: deploy_mujoco.Robot, frames: list[np.ndarray]) -> Callable[[], None]:
    """Make a function that adds a picture of every second step to ``frames``."""
    model, count = robot.model, [0]
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.4, 0.6
    model.vis.global_.offwidth, model.vis.global_.offheight = 960, 540
    model.geom_rgba[:], plane = (0.9, 0.5, 0.2, 1.0), model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_rgba[plane] = 0.5, 0.55, 0.6, 1.0
    renderer, camera = mujoco.Renderer(model, 540, 960), mujoco.MjvCamera()
    camera.distance, camera.elevation, camera.azimuth = 1.8, -15, 120

    def after_step() -> None:
        count[0] += 1
        if count[0] % 2:
            camera.lookat = robot.data.xpos[robot.base]
            renderer.update_scene(robot.data, camera)
            frames.append(renderer.render())

    return after_step


def main() -> None:
    """Export, run the episodes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task")
    parser.add_argument("run")
    parser.add_argument("--spread", type=float, default=0.0, help="largest distance from the default pose at the start")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    from stripe_newton.cli import main as stripe_newton

    with tempfile.TemporaryDirectory() as folder:
        if code := stripe_newton(
            ["export", args.run, "--task", args.task, "--mjcf", "--device", "cpu", "--out", folder]
        ):
            raise SystemExit(code)
        policy = deploy_mujoco.Policy(f"{folder}/policy.onnx")
        robot = deploy_mujoco.Robot(f"{folder}/robot.xml", policy.metadata)
    rng, frames, results = np.random.default_rng(args.seed), [], []
    for number in range(args.episodes):
        film = camera_on(robot, frames) if args.out and number == 0 else None
        command = deploy_mujoco.draw_command(policy.metadata, rng)
        offset = deploy_mujoco.draw_offset(robot, args.spread, rng)
        results.append(deploy_mujoco.episode(robot, policy, command, args.seconds, film, offset))
    print(f"MuJoCo {mujoco.__version__}, {args.task}, {args.episodes} episodes of {args.seconds:g} s")
    print(deploy_mujoco.report(results))
    if frames:
        from stripe_newton.viewers import VideoWriter

        args.out.mkdir(parents=True, exist_ok=True)
        with VideoWriter(args.out / "mujoco.mp4", fps=round(0.5 / robot.rates["step_dt"])) as video:
            for frame in frames:
                video.add(frame)


if __name__ == "__main__":
    main()
