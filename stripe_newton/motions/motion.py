# SPDX-License-Identifier: Apache-2.0
"""Motion: root poses and joint positions of a robot, frame by frame, at a constant rate."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

__all__ = ["Motion", "MotionError"]


class MotionError(ValueError):
    """A motion that cannot be used: its file, or the robot that it is for; the message says what is wrong."""


@dataclass(frozen=True)
class Motion:
    """Root poses and joint positions of a robot, frame by frame, float64."""

    name: str
    """Name, for messages: its file."""
    fps: float
    """Frames a second."""
    root_pos: np.ndarray
    """Positions of the root link [m], shape ``(num_frames, 3)``."""
    root_quat: np.ndarray
    """Orientations of the root link (x, y, z, w), unit length, shape ``(num_frames, 4)``."""
    joint_pos: np.ndarray
    """Joint positions [rad or m], shape ``(num_frames, num_joints)``."""
    joint_names: tuple[str, ...] | None = None
    """Names of the joints; None for those of the robot, in its order."""
    body_pos: np.ndarray | None = None
    """Positions of the robot's bodies as the file has them [m], shape ``(num_frames, num_bodies, 3)``: for checks."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.root_pos)

    @property
    def duration(self) -> float:
        """Time from the first frame to the last [s]."""
        return (self.num_frames - 1) / self.fps

    def resampled(self, fps: float) -> Motion:
        """The same motion at another rate: straight lines between frames, and arcs between orientations.

        Args:
            fps: Frames a second. The first frame stays, the last one is the last that is not later than the motion's.
        """
        if abs(fps - self.fps) < 1.0e-9 * fps:
            return self
        # A small excess, so that rounding does not lose the last frame where both rates meet.
        times = np.arange(int(np.floor(self.duration * fps + 1.0e-6)) + 1) / fps
        times = np.minimum(times, self.duration)
        own = np.arange(self.num_frames) / self.fps
        from scipy.spatial.transform import Rotation, Slerp  # here, as both take long to import

        return dataclasses.replace(
            self,
            fps=fps,
            root_pos=_interpolated(times, own, self.root_pos),
            root_quat=Slerp(own, Rotation.from_quat(self.root_quat))(times).as_quat(),
            joint_pos=_interpolated(times, own, self.joint_pos),
            body_pos=None if self.body_pos is None else _interpolated(times, own, self.body_pos),
        )

    def velocities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocities by differences: central ones, one-sided at both ends.

        Returns:
            Of the root link's origin [m/s], ``(num_frames, 3)``; of its rotation, in the world [rad/s],
            ``(num_frames, 3)``; of the joints, ``(num_frames, num_joints)``.
        """
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

        step = 1.0 / self.fps
        rotations = Rotation.from_quat(self.root_quat)
        before = np.maximum(np.arange(self.num_frames) - 1, 0)
        after = np.minimum(np.arange(self.num_frames) + 1, self.num_frames - 1)
        turns = (rotations[after] * rotations[before].inv()).as_rotvec()
        spans = (after - before) * step
        return (
            np.gradient(self.root_pos, step, axis=0),
            turns / spans[:, None],
            np.gradient(self.joint_pos, step, axis=0),
        )

    def in_order(self, names: list[str]) -> Motion:
        """The same motion with the joints of a robot, in its order.

        Raises:
            MotionError: if the motion has other joints.
        """
        own = self.joint_names
        if own is None:
            if self.joint_pos.shape[1] != len(names):
                raise MotionError(
                    f"{self.name}: has {self.joint_pos.shape[1]} joints, the robot has {len(names)}; if they are some "
                    f"of its joints or in another order, name them by joint_names"
                )
            return self
        missing = [name for name in names if name not in own]
        if missing or len(own) != self.joint_pos.shape[1]:
            what = f"has no joint {', '.join(missing)}" if missing else f"has {self.joint_pos.shape[1]} joints"
            raise MotionError(f"{self.name}: {what}; joint_names has {len(own)}: {', '.join(own)}")
        columns = [own.index(name) for name in names]
        return dataclasses.replace(self, joint_pos=self.joint_pos[:, columns], joint_names=None)


def _interpolated(times: np.ndarray, own: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at other times, on straight lines between those that are given."""
    position = np.interp(times, own, np.arange(len(own)))
    low = np.minimum(position.astype(int), len(own) - 2)
    share = (position - low).reshape(-1, *(1,) * (values.ndim - 1))
    return values[low] * (1.0 - share) + values[low + 1] * share
