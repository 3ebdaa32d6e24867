# SPDX-License-Identifier: Apache-2.0
"""Motion library: several motions of one robot at the control rate, with the poses of its bodies, in bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch

from .motion import Motion, MotionError

if TYPE_CHECKING:
    from stripe_newton.assets import Articulation
    from stripe_newton.sim import Simulation

__all__ = ["MotionLibrary"]

_BIN = 1.0
"""Length of a bin [s]."""
_TOLERANCE = 0.03
"""Distance up to which the bodies of a file may be off from those of the robot, on average [m]."""

_CHECKED = 100
"""Frames of a file whose bodies are compared."""


@dataclass
class MotionLibrary:
    """Frames of all motions, one motion after the other, at one rate.

    Velocities are differences of the poses at that rate, those of bodies follow from them by forward kinematics.
    """

    fps: float
    """Frames a second: the control rate."""
    names: list[str] = field(default_factory=list)
    """Names of the motions."""
    joint_pos: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """Joint positions [rad or m], float32, shape ``(num_frames, num_joints)``."""
    joint_vel: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """Joint velocities [rad/s or m/s], shape ``(num_frames, num_joints)``."""
    body_pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 7), np.float32))
    """Poses of the link frames [m], (x, y, z, w), shape ``(num_frames, num_bodies, 7)``."""
    body_vel: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 6), np.float32))
    """Velocities of the centres of mass [m/s, rad/s], shape ``(num_frames, num_bodies, 6)``."""
    lengths: list[int] = field(default_factory=list)
    """Numbers of frames of the motions."""

    @classmethod
    def of_robot(cls, motions: Sequence[Motion], robot: Articulation, sim: Simulation, fps: float) -> MotionLibrary:
        """The library of some motions for a robot of a simulation, whose state stays as it is.

        Args:
            motions: The motions, of any rates.
            robot: The robot; its root floats.
            sim: Its simulation, built. All its environments compute forward kinematics.
            fps: Frames a second of the library.

        Raises:
            MotionError: a motion is of another robot, or shorter than two frames of the library.
        """
        if robot.is_fixed_base:
            raise MotionError("the root of the robot is held; motions are of robots that float")
        for motion in motions:
            if motion.duration * fps < 1.0 - 1.0e-6:
                step = 1.0 / fps
                raise MotionError(f"{motion.name}: lasts {motion.duration:.3g} s, must last {step:.3g} s or longer")
        ready = [motion.in_order(list(robot.joint_names)).resampled(fps) for motion in motions]
        states = [_with_bodies(motion, robot, sim) for motion in ready]
        return cls(
            fps=fps,
            names=[motion.name for motion in ready],
            joint_pos=np.concatenate([motion.joint_pos for motion in ready]).astype(np.float32),
            joint_vel=np.concatenate([motion.velocities()[2] for motion in ready]).astype(np.float32),
            body_pose=np.concatenate([pose for pose, _ in states]),
            body_vel=np.concatenate([vel for _, vel in states]),
            lengths=[motion.num_frames for motion in ready],
        )

    @property
    def starts(self) -> np.ndarray:
        """First frames of the motions, shape ``(num_motions,)``."""
        return np.cumsum([0, *self.lengths[:-1]])

    @property
    def last(self) -> np.ndarray:
        """Last frame of the motion of each frame, shape ``(num_frames,)``."""
        return np.repeat(self.starts + np.array(self.lengths) - 1, self.lengths)

    def bins(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bins of about a second: first frames, numbers of frames to begin at, and motions, shape ``(num_bins,)`` each.

        The last frame of a motion is in no bin: an episode that began there would be over.
        """
        starts, sizes, motions = list[int](), list[int](), list[int]()
        for motion, (first, length) in enumerate(zip(self.starts, self.lengths, strict=True)):
            count = max(1, round((length - 1) / (_BIN * self.fps)))
            edges = np.linspace(0, length - 1, count + 1).round().astype(int)
            starts += [int(first + edge) for edge in edges[:-1]]
            sizes += list(np.diff(edges))
            motions += [motion] * count
        return np.array(starts), np.array(sizes), np.array(motions)

    def bin_of_frames(self) -> np.ndarray:
        """Bin of each frame, shape ``(num_frames,)``; of the last frame of a motion its last bin."""
        starts, _, _ = self.bins()
        return np.searchsorted(starts, np.arange(len(self.joint_pos)), side="right") - 1


def _with_bodies(motion: Motion, robot: Articulation, sim: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Poses and velocities of the bodies by the simulation's forward kinematics, many frames at a time."""
    lin_vel, ang_vel, joint_vel = motion.velocities()
    root = np.concatenate((motion.root_pos, motion.root_quat, lin_vel, ang_vel), axis=1)
    count, device = sim.num_envs, sim.device
    before = sim.state.joint_q.numpy().copy(), sim.state.joint_qd.numpy().copy()
    poses, velocities = list[np.ndarray](), list[np.ndarray]()
    for first in range(0, motion.num_frames, count):
        rows = np.minimum(np.arange(first, first + count), motion.num_frames - 1)
        state, joints, speeds = (
            torch.as_tensor(values[rows], dtype=torch.float32, device=device)
            for values in (root, motion.joint_pos, joint_vel)
        )
        robot.write_root_link_state_to_sim(state)
        robot.write_joint_state_to_sim(joints, speeds)
        sim.forward()
        kept = slice(0, min(count, motion.num_frames - first))
        poses.append(robot.data.body_pose_w[kept].cpu().numpy().copy())
        velocities.append(robot.data.body_vel_w[kept].cpu().numpy().copy())
    sim.state.joint_q.assign(before[0])
    sim.state.joint_qd.assign(before[1])
    sim.forward()
    pose = np.concatenate(poses)
    _check_bodies(motion, pose)
    return pose, np.concatenate(velocities)


def _check_bodies(motion: Motion, pose: np.ndarray) -> None:
    """Compare the bodies with those of the file, where that has as many."""
    if motion.body_pos is None or motion.body_pos.shape[1] != pose.shape[1]:
        return
    # In any order: files of Isaac Lab have bodies in another order than those of MuJoCo, the point cloud is the same.
    some = np.linspace(0, motion.num_frames - 1, min(motion.num_frames, _CHECKED)).astype(int)
    own, other = (x[some] - x[some].mean(axis=1, keepdims=True) for x in (pose[..., :3], motion.body_pos))
    nearest = np.linalg.norm(own[:, :, None] - other[:, None], axis=-1).min(axis=2)
    off = float(nearest.mean())
    if off > _TOLERANCE:
        raise MotionError(
            f"{motion.name}: bodies are {off:.2g} m from where its joints put those of the robot: it is of another "
            "robot, or its joints are in another order (name them by joint_names), or the numbers of its quaternions "
            "(set quaternions)"
        )
