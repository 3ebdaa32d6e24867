# SPDX-License-Identifier: Apache-2.0
"""Run a trained walking policy in plain MuJoCo, on the CPU, with nothing of this package between network and robot.

    python tools/sim_to_sim.py TASK RUN [--episodes 20] [--seconds 20] [--seed 0] [--out DIR]

The robot is written as MJCF once, on a plane, with the gains and limits of the task. Then MuJoCo's C library steps it,
ONNX Runtime runs ``exported/policy.onnx``, and what the network sees is computed here in NumPy from MuJoCo's own
quantities. Prints how many episodes ended without a fall and how well commands were followed; with --out also a video.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import onnxruntime

if sys.platform == "linux" and not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported; draws without a window
import mujoco

from stripe_newton.configclass import resolve_name
from stripe_newton.envs import ManagerBasedRLEnv

FALLEN = 1.2
"""Angle between the base's up axis and the vertical at which a robot has fallen [rad]."""


class Robot:
    """A robot in MuJoCo: its model, and where the task's joints are in it."""

    def __init__(self, task: str):
        cfg = resolve_name(gymnasium.spec(task).kwargs["env_cfg_entry_point"])()
        cfg.sim.device, cfg.scene.num_envs = "cpu", 1
        self.cfg = cfg
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.xml"
            cfg.sim.solver.save_to_mjcf = str(path)
            env = ManagerBasedRLEnv(cfg)
            self.model = mujoco.MjModel.from_xml_path(str(path))
        data = env.scene["robot"].data
        self.default_pos = data.default_joint_pos[0].numpy().copy()
        self.start = data.default_root_state[0, :7].numpy().copy()
        self.scale, self.offset = _affine(env)
        self.step_dt, self.decimation = env.step_dt, cfg.decimation
        names = [mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_JOINT, j) or "" for j in range(self.model.njnt)]
        ends = [(n.replace(":", "_ang"), n.replace(":", "_lin")) for n in data.joint_names]  # as Newton writes axes
        joints = [next(j for j, name in enumerate(names) if name.endswith(end)) for end in ends]
        self.qpos, self.qvel = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        drives = {int(self.model.actuator_trnid[a, 0]): a for a in range(self.model.nu)}
        self.drives = np.array([drives[j] for j in joints])
        limits = self.model.jnt_actfrcrange[joints]
        if cfg.sim.solver.drive_limits:
            self.model.actuator_forcelimited[self.drives], self.model.actuator_forcerange[self.drives] = True, limits
        self.base = int(self.model.jnt_bodyid[0])
        _light(self.model)
        self.model.opt.timestep = cfg.sim.dt
        env.close()


def _light(model: Any) -> None:
    """Light and colours for the video."""
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.4, 0.6
    model.vis.global_.offwidth, model.vis.global_.offheight = 960, 540
    model.geom_rgba[:], plane = (0.9, 0.5, 0.2, 1.0), model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_rgba[plane] = 0.5, 0.55, 0.6, 1.0


def _affine(env: ManagerBasedRLEnv) -> tuple[np.ndarray, np.ndarray]:
    """Position targets as ``scale * action + offset``, read off the environment's own processing."""
    import torch

    targets = []
    for value in (0.0, 1.0):
        env.reset(seed=0)
        env.step(torch.full((1, env.action_manager.total_action_dim), value))
        targets.append(env.scene["robot"].data.joint_pos_target[0].numpy().copy())
    return targets[1] - targets[0], targets[0]


def observations(robot: Robot) -> dict[str, Callable[[mujoco.MjData, np.ndarray, np.ndarray], np.ndarray]]:
    """What a policy may see, by the name of the term's function."""

    def turn(data: mujoco.MjData) -> np.ndarray:
        return data.xmat[robot.base].reshape(3, 3).T

    def velocity(data: mujoco.MjData) -> np.ndarray:
        out = np.zeros(6)  # at the centre of mass
        mujoco.mj_objectVelocity(robot.model, data, mujoco.mjtObj.mjOBJ_BODY, robot.base, out, 0)
        return out

    return {
        "base_lin_vel": lambda data, command, action: turn(data) @ velocity(data)[3:],
        "base_ang_vel": lambda data, command, action: turn(data) @ velocity(data)[:3],
        "projected_gravity": lambda data, command, action: turn(data) @ np.array([0.0, 0.0, -1.0]),
        "generated_commands": lambda data, command, action: command,
        "joint_pos_rel": lambda data, command, action: data.qpos[robot.qpos] - robot.default_pos,
        "joint_vel_rel": lambda data, command, action: data.qvel[robot.qvel],
        "last_action": lambda data, command, action: action,
    }


def functions_of(robot: Robot) -> list[Callable[..., np.ndarray]]:
    """The terms of the policy's group, in order.

    Raises:
        SystemExit: for a term that this program does not know.
    """
    known, group, found = observations(robot), robot.cfg.observations.policy, []
    for field in group.__dataclass_fields__:
        term = getattr(group, field)
        function = getattr(term, "func", None)
        if function is None:
            continue
        name = function.func.__name__ if hasattr(function, "func") else function.__name__
        if name not in known:
            raise SystemExit(
                f"observations.policy.{field}: '{name}' is not computed here; there are {', '.join(known)}"
            )
        scale = np.asarray(term.scale if term.scale is not None else 1.0)
        found.append(lambda *state, f=known[name], s=scale: s * f(*state))
    return found


def episode(robot: Robot, network: Any, rng: np.random.Generator, seconds: float, frames: list | None) -> dict:
    """One episode with one command; how far it came and how well it followed."""
    data = mujoco.MjData(robot.model)
    data.qpos[:3] = robot.start[:3]
    data.qpos[3:7] = robot.start[[6, 3, 4, 5]]  # w first
    data.qpos[robot.qpos] = robot.default_pos
    mujoco.mj_forward(robot.model, data)
    ranges = robot.cfg.commands.base_velocity.ranges
    command = np.array([rng.uniform(*b) for b in (ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z)])
    functions, action = functions_of(robot), np.zeros(len(robot.drives))
    seen, renderer = [], mujoco.Renderer(robot.model, 540, 960) if frames is not None else None
    for index in range(round(seconds / robot.step_dt)):
        obs = np.concatenate([f(data, command, action) for f in functions]).astype(np.float32)[None]
        action = network.run(None, {network.get_inputs()[0].name: obs})[0][0].astype(float)
        data.ctrl[robot.drives] = robot.scale * action + robot.offset
        mujoco.mj_step(robot.model, data, robot.decimation)
        if np.arccos(np.clip(data.xmat[robot.base][8], -1.0, 1.0)) > FALLEN:
            break
        known = observations(robot)
        linear, angular = (known[n](data, command, action) for n in ("base_lin_vel", "base_ang_vel"))
        if index * robot.step_dt > 1.0:  # once it is on its way
            seen.append([*(linear[:2] - command[:2]), angular[2] - command[2]])
        if renderer is not None and index % 2 == 0:
            camera = mujoco.MjvCamera()
            camera.lookat, camera.distance, camera.elevation, camera.azimuth = data.xpos[robot.base], 1.8, -15, 120
            renderer.update_scene(data, camera)
            frames.append(renderer.render())
    error = np.array(seen) if seen else np.full((1, 3), math.nan)
    return {
        "finished": index + 1 == round(seconds / robot.step_dt),
        "seconds": (index + 1) * robot.step_dt,
        "error_lin": float(np.linalg.norm(error[:, :2], axis=1).mean()),
        "error_yaw": float(np.abs(error[:, 2]).mean()),
    }


def main() -> None:
    """Run the episodes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task")
    parser.add_argument("run", type=Path)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    import stripe_tasks  # noqa: F401

    robot = Robot(args.task)
    network = onnxruntime.InferenceSession(str(args.run / "exported" / "policy.onnx"))
    rng, frames = np.random.default_rng(args.seed), [] if args.out else None
    results = [episode(robot, network, rng, args.seconds, frames if i == 0 else None) for i in range(args.episodes)]
    mean = {k: float(np.nanmean([r[k] for r in results])) for k in results[0]}
    print(f"MuJoCo {mujoco.__version__}, {args.task}, {args.episodes} episodes of {args.seconds:g} s")
    print(f"without a fall      {100 * mean['finished']:.0f} %")
    print(f"mean length         {mean['seconds']:.1f} s")
    print(f"velocity error      {mean['error_lin']:.3f} m/s")
    print(f"yaw rate error      {mean['error_yaw']:.3f} rad/s")
    if args.out and frames:
        from stripe_newton.viewers import VideoWriter

        args.out.mkdir(parents=True, exist_ok=True)
        with VideoWriter(args.out / "mujoco.mp4", fps=round(0.5 / robot.step_dt)) as video:
            for frame in frames:
                video.add(frame)


if __name__ == "__main__":
    main()
