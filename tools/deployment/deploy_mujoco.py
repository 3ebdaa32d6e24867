# SPDX-License-Identifier: Apache-2.0
"""Deployment in plain MuJoCo: run an exported policy with numpy, mujoco and onnxruntime, without this package.

    python tools/deployment/deploy_mujoco.py policy.onnx robot.xml
        [--command 0.5 0 0] [--spread 0.2] [--episodes 20] [--seconds 20] [--view]

All facts about the task come from ``policy.onnx``: the joints and their order, the default pose, gains and limits, how
actions become targets, the observations with their scales, and the rates. ``robot.xml`` is the robot as MJCF, such as
``stripe-newton export RUN --mjcf`` writes it; its actuators are replaced. Without ``--command`` each episode draws a
command from the ranges of the training. The program prints the share of episodes without a fall and the error of the
velocities; of a robot on a fixed base the mean distance of each joint from the default pose, which it starts away from
by up to ``--spread``. For a real robot, write another :class:`Robot`.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import onnxruntime

FALLEN = 1.2
"""Angle between the base's up axis and the vertical at which a robot has fallen [rad]."""

Metadata = dict[str, Any]
"""JSON from the policy's file, or a part of it."""


class Policy:
    """Policy: the network, its state if it has one, and the metadata."""

    def __init__(self, path: str):
        self.session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        stored = self.session.get_modelmeta().custom_metadata_map
        if "format_version" not in stored:
            raise SystemExit(f"{path}: has no metadata; was it written by 'stripe-newton export RUN'?")
        self.metadata = {key: json.loads(value) for key, value in stored.items() if key.islower()}
        self.reset()

    def reset(self) -> None:
        """Clear the state, at the start of an episode."""
        states = self.metadata["network"]["states"]
        self.state = {s["input"]: np.zeros([1 if n == "batch" else n for n in s["shape"]], np.float32) for s in states}

    def __call__(self, groups: dict[str, np.ndarray]) -> np.ndarray:
        """Actions for one robot; ``groups`` are the observation groups by name."""
        network, feed = self.metadata["network"], dict(self.state)
        for entry in network["inputs"]:
            feed[entry["name"]] = np.concatenate([groups[g] for g in entry["groups"]]).astype(np.float32)[None]
        names = ["actions", *(s["output"] for s in network["states"])]
        actions, *states = self.session.run(names, feed)
        self.state = {s["input"]: value for s, value in zip(network["states"], states)}
        clip = self.metadata["actions"]["clip"]
        return actions[0].astype(float) if clip is None else np.clip(actions[0].astype(float), -clip, clip)


class Robot:
    """Robot in MuJoCo: takes targets and gives measurements, with the joints in the policy's order."""

    def __init__(self, path: str, metadata: Metadata):
        self.rates, (name, *others) = metadata["rates"], list(metadata["assets"])
        self.asset = asset = metadata["assets"][name]
        if others:
            raise SystemExit(f"this program knows one robot, the policy has {', '.join(metadata['assets'])}")
        spec = mujoco.MjSpec.from_file(path)
        joints = [_find(spec, joint) for joint in asset["joint_names"]]
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        gains = asset["stiffness"], asset["damping"], asset["effort_limit"]
        for joint, kp, kd, limit in zip(joints, *gains):
            drive = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            drive.gaintype, drive.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
            drive.gainprm[0], drive.biasprm[1:3] = kp, (-kp, -kd)  # kp (target - q) - kd qd
            limited = spec.joint(joint).actfrcrange.any() and not (metadata["solver"] or {}).get("drive_limits")
            if limit is not None and not limited:  # else the file limits the effort of the joint
                drive.forcelimited, drive.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, (-limit, limit)
        self.model = spec.compile()
        self.model.opt.timestep = self.rates["physics_dt"]
        self.data = mujoco.MjData(self.model)
        ids = [self.model.joint(joint).id for joint in joints]
        self.qpos, self.qvel = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]
        body = self.model.jnt_bodyid[ids[0]]
        while self.model.body_parentid[body]:
            body = self.model.body_parentid[body]
        self.base = int(body)
        self.free = None if asset["fixed_base"] else int(self.model.jnt_qposadr[self.model.body_jntadr[body]])
        self.default_pos = np.array(asset["default_joint_pos"])

    def reset(self, offset: np.ndarray | float = 0.0) -> None:
        """Take the default pose, with the joints away from it by ``offset`` [m or rad]."""
        mujoco.mj_resetData(self.model, self.data)
        x, y, z, w = self.asset["default_root_quat_xyzw"]
        if self.free is not None:
            self.data.qpos[self.free : self.free + 7] = [*self.asset["default_root_pos"], w, x, y, z]
        self.data.qpos[self.qpos] = self.default_pos + offset
        self.data.ctrl[:] = self.default_pos
        mujoco.mj_forward(self.model, self.data)

    def step(self, targets: np.ndarray, efforts: np.ndarray | float = 0.0) -> None:
        """Hold targets for one step of the policy.

        Args:
            targets: Positions [m or rad]; NaN leaves a joint at its last target.
            efforts: Efforts added to those of the drives [N or N m].
        """
        self.data.ctrl[:] = np.where(np.isnan(targets), self.data.ctrl, targets)
        limits = [math.inf if limit is None else limit for limit in self.asset["effort_limit"]]
        self.data.qfrc_applied[self.qvel] = np.clip(efforts, np.negative(limits), limits)
        mujoco.mj_step(self.model, self.data, self.rates["decimation"])

    @property
    def rotation(self) -> np.ndarray:
        """Rotation matrix from the world's axes to those of the base, (3, 3)."""
        return self.data.xmat[self.base].reshape(3, 3).T

    @property
    def velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """Linear velocity of the base's centre of mass [m/s] and angular velocity [rad/s], in the base's axes."""
        out = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, self.base, out, 0)
        return self.rotation @ out[3:], self.rotation @ out[:3]

    @property
    def has_fallen(self) -> bool:
        """Whether the base leans by more than ``FALLEN``; one that is fixed does not."""
        return self.free is not None and bool(np.arccos(np.clip(self.data.xmat[self.base][8], -1.0, 1.0)) > FALLEN)


def _find(spec: mujoco.MjSpec, joint: str) -> str:
    """The joint's name in the file, which may have a prefix; MuJoCo splits a joint of several axes, ``name:k``."""
    names = [j.name for j in spec.joints]
    wanted = joint, joint.replace(":", "_ang"), joint.replace(":", "_lin")
    found = [n for n in names if n in wanted] or [n for n in names if n.endswith(tuple(f"_{w}" for w in wanted))]
    if len(found) != 1:
        raise SystemExit(f"joint '{joint}': found {', '.join(found) or 'none'} among {', '.join(names)}")
    return found[0]


class Observations:
    """Observations of the policy, computed from the robot's measurements as the metadata define them."""

    def __init__(self, robot: Robot, metadata: Metadata):
        self.robot, self.groups = robot, metadata["observations"]
        self.command, self.action = np.zeros(3), np.zeros(metadata["actions"]["size"])
        self.history: dict[tuple[str, str], list[np.ndarray]] = {}
        for group in self.groups:
            if group["terms"] is None:
                raise SystemExit(f"observations '{group['name']}': a direct environment does not say what is in them")
            for term in group["terms"]:
                name = term["function"].rpartition(":")[2]
                if name not in self.known or term["modifiers"]:
                    known = ", ".join(self.known)
                    raise SystemExit(f"observation '{term['name']}': '{name}' is not measured here; there are {known}")

    @property
    def known(self) -> dict[str, Callable[[Metadata], np.ndarray]]:
        """Measurements by the name of the term's function."""
        robot, data = self.robot, self.robot.data

        def joints(params: Metadata) -> list[int]:
            everyone = robot.asset["joint_names"]
            return [everyone.index(n) for n in params.get("asset_cfg", {}).get("joint_names", everyone)]

        return {
            "base_lin_vel": lambda params: robot.velocity[0],
            "base_ang_vel": lambda params: robot.velocity[1],
            "projected_gravity": lambda params: robot.rotation @ np.array([0.0, 0.0, -1.0]),
            "generated_commands": lambda params: self.command,
            "joint_pos": lambda params: data.qpos[robot.qpos][joints(params)],
            "joint_pos_rel": lambda params: (data.qpos[robot.qpos] - robot.default_pos)[joints(params)],
            "joint_vel": lambda params: data.qvel[robot.qvel][joints(params)],
            "joint_vel_rel": lambda params: data.qvel[robot.qvel][joints(params)],
            "last_action": lambda params: self.action,
        }

    def reset(self) -> None:
        """Clear histories and the last action, at the start of an episode."""
        self.history.clear()
        self.action = np.zeros_like(self.action)

    def __call__(self) -> dict[str, np.ndarray]:
        """Groups by name: terms are clipped, scaled, put into their histories, oldest first, and joined."""
        found = {}
        for group in self.groups:
            parts = []
            for term in group["terms"]:
                value = self.known[term["function"].rpartition(":")[2]](term["params"])
                if term["clip"] is not None:
                    value = np.clip(value, *term["clip"])
                value = value * np.asarray(1.0 if term["scale"] is None else term["scale"])
                length = max(1, term["history_length"])
                past = self.history.setdefault((group["name"], term["name"]), [value] * length)
                past[:] = [*past[1:], value]
                parts += past
            joined, norm = np.concatenate(parts), group["normalization"]
            if norm is not None:
                joined = (joined - np.array(norm["mean"])) / (np.array(norm["std"]) + norm["eps"])
                joined = np.clip(joined, -norm["clip"], norm["clip"])
            found[group["name"]] = joined
        return found


def targets(metadata: Metadata, action: np.ndarray) -> np.ndarray:
    """Position targets of all joints in the asset's order [m or rad]; NaN where no action moves a joint."""
    return _joint_values(metadata, action, "JointPositionAction", math.nan)


def efforts(metadata: Metadata, action: np.ndarray) -> np.ndarray:
    """Efforts of all joints in the asset's order [N or N m]; 0 where no action drives a joint."""
    return _joint_values(metadata, action, "JointEffortAction", 0.0)


def _joint_values(metadata: Metadata, action: np.ndarray, kind: str, other: float) -> np.ndarray:
    """What the actions of a kind set for each joint, and ``other`` where none does."""
    known = "JointPositionAction", "JointEffortAction"
    (asset,) = metadata["assets"].values()
    out = np.full(len(asset["joint_names"]), other)
    for term in metadata["actions"]["terms"]:
        if term["type"] not in known:
            raise SystemExit(f"action '{term['name']}': {term['type']} is not known here; there are {', '.join(known)}")
        if term["type"] != kind:
            continue
        value = action[term["first"] : term["first"] + term["size"]]
        value = np.array(term["scale"]) * value + np.array(term["offset"])
        for i, (low, high) in enumerate(term["clip"] or []):
            value[i] = min(max(value[i], -math.inf if low is None else low), math.inf if high is None else high)
        out[[asset["joint_names"].index(name) for name in term["joint_names"]]] = value
    return out


def draw_command(metadata: Metadata, rng: np.random.Generator) -> np.ndarray:
    """A velocity from the ranges of the training: forward, sideways [m/s], yaw rate [rad/s]; empty without commands."""
    if not metadata["commands"]:
        return np.zeros(0)
    (command,) = metadata["commands"].values()
    return np.array([rng.uniform(*command["ranges"][name]) for name in ("lin_vel_x", "lin_vel_y", "ang_vel_z")])


def episode(
    robot: Robot,
    policy: Policy,
    command: np.ndarray,
    seconds: float,
    after_step: Callable[[], None] | None = None,
    offset: np.ndarray | float = 0.0,
) -> dict[str, float]:
    """Run an episode with one command, and joints that start away from the default pose by ``offset`` [m or rad].

    Returns:
        Its length, and mean errors from its first second on: of the velocities, or without a command the distances of
        the joints from the default pose, by name.
    """
    observe, dt, errors = Observations(robot, policy.metadata), robot.rates["step_dt"], []
    robot.reset(offset)
    policy.reset()
    observe.command = command
    steps = round(seconds / dt)
    for step in range(1, steps + 1):
        observe.action = policy(observe())
        robot.step(targets(policy.metadata, observe.action), efforts(policy.metadata, observe.action))
        if after_step is not None:
            after_step()
        if robot.has_fallen:
            break
        if step * dt > 1.0:  # after it has had time to start walking, or to come back
            linear, angular = robot.velocity
            lateral = [np.linalg.norm(linear[:2] - command[:2]), abs(angular[2] - command[2])] if command.size else []
            errors.append(lateral or np.abs(robot.data.qpos[robot.qpos] - robot.default_pos))
    names = ["error_lin", "error_yaw"] if command.size else robot.asset["joint_names"]
    error = np.mean(errors, axis=0).tolist() if errors else [math.nan] * len(names)
    finished = {} if robot.free is None else {"finished": float(not robot.has_fallen)}
    return {**finished, "seconds": step * dt, **dict(zip(names, error))}


def report(results: list[dict[str, float]]) -> str:
    """The means over episodes, as a table."""
    numbers = {k: [r[k] for r in results if not math.isnan(r[k])] for k in results[0]}
    mean = {k: sum(v) / len(v) if v else math.nan for k, v in numbers.items()}
    known = {
        "finished": lambda share: f"without a fall      {100 * share:.0f} %",
        "seconds": lambda seconds: f"mean length         {seconds:.1f} s",
        "error_lin": lambda error: f"velocity error      {error:.3f} m/s",
        "error_yaw": lambda error: f"yaw rate error      {error:.3f} rad/s",
    }
    return "\n".join(known[n](x) if n in known else f"{n + ' off by':<20}{x:.3f}" for n, x in mean.items())


def draw_offset(robot: Robot, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Distances of the joints from the default pose, uniform in ``+-spread`` [m or rad]."""
    return rng.uniform(-spread, spread, len(robot.default_pos))


def main() -> None:
    """Run the episodes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="policy.onnx, as 'stripe-newton export' writes it")
    parser.add_argument("robot", help="MJCF file: the exported robot.xml, or your own with joints of the same names")
    command = "velocities [m/s, rad/s] to follow; by default others in each episode, from the ranges of the training"
    parser.add_argument("--command", type=float, nargs=3, metavar=("X", "Y", "YAW"), help=command)
    parser.add_argument("--spread", type=float, default=0.0, help="largest distance from the default pose at the start")
    parser.add_argument("--episodes", type=int, default=20, help="number of episodes (default: 20)")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of an episode (default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the commands and of the starts (default: 0)")
    parser.add_argument("--view", action="store_true", help="show it in MuJoCo's viewer, in real time")
    args = parser.parse_args()
    policy = Policy(args.policy)
    robot, rng, after_step = Robot(args.robot, policy.metadata), np.random.default_rng(args.seed), None
    if args.view:
        import time

        from mujoco import viewer

        window = viewer.launch_passive(robot.model, robot.data)

        def after_step() -> None:
            window.sync()
            time.sleep(robot.rates["step_dt"])

    results = []
    for _ in range(args.episodes):
        command = np.array(args.command) if args.command else draw_command(policy.metadata, rng)
        offset = draw_offset(robot, args.spread, rng)
        results.append(episode(robot, policy, command, args.seconds, after_step, offset))
    task = policy.metadata["task"]
    print(f"MuJoCo {mujoco.__version__}, {task}, {args.episodes} episodes of {args.seconds:g} s")
    print(report(results))


if __name__ == "__main__":
    main()
