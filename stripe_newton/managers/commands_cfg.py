# SPDX-License-Identifier: Apache-2.0
"""Configs of command terms: velocities, poses, positions on the ground."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Literal

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import AnyFloat, NonNegativeFloat, NonNegativeInt, UnitFloat

__all__ = [
    "CommandManagerCfg",
    "CommandTermCfg",
    "MotionCommandCfg",
    "NormalVelocityCommandCfg",
    "NullCommandCfg",
    "TerrainBasedPose2dCommandCfg",
    "UniformPose2dCommandCfg",
    "UniformPoseCommandCfg",
    "UniformVelocityCommandCfg",
]

Range = tuple[float, float]


@configclass
class _RangesCfg:
    """Bounds: pairs of numbers."""

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in type(self).__dataclass_fields__:
            bounds = getattr(self, name)
            if bounds not in (None, MISSING) and not bounds[0] <= bounds[1]:
                yield name, f"is {bounds}, must be (low, high) with low <= high"


@configclass
class CommandTermCfg:
    """Config of a command term: a goal for the policy, resampled at intervals.

    A user's term gives ``resample(env, command, rng, ...)``, and ``update(env, command, ...)`` if it changes between
    samples: Warp functions whose argument ``command`` is a ``stripe_kernels.data.CommandData`` of ``size`` numbers.
    Other arguments are taken from ``params`` and from fields of the config, which a subclass may add.
    """

    MAY_BE_NONE: ClassVar[bool] = True

    class_type: type | None = None
    """Class of a torch term, derived from :class:`CommandTerm`, made as ``class_type(cfg, env)``; ``resample``,
    ``update``, ``size`` and ``metrics`` are then without effect. None for a term of Warp functions."""
    asset_name: str = "robot"
    """Asset that is commanded."""
    resampling_time_range: tuple[AnyFloat, AnyFloat] = MISSING
    """Bounds of the time between two samples [s]."""
    resample: Callable[..., object] | None = None
    """Warp function that samples a command."""
    update: Callable[..., object] | None = None
    """Warp function that updates the command in every step."""
    size: NonNegativeInt = 0
    """Number of values of the command."""
    params: dict[str, Any] = {}
    """Further arguments of the functions."""
    metrics: dict[str, Callable[..., object]] = {}
    """Warp functions ``-> float`` by name; their means over the episode are logged."""
    debug_vis: bool = False
    """Draw velocities, poses and positions in pictures and films, and in the live view from the start; there a checkbox
    does so, too. Commands of other kinds are not drawn."""

    @property
    def is_users(self) -> bool:
        """Whether a class of the user computes it, rather than Warp functions."""
        return self.class_type is not None and not getattr(self.class_type, "is_fused", bool)()

    def problems(self) -> Iterator[tuple[str, str]]:
        bounds = self.resampling_time_range
        if bounds is not MISSING and not 0 < bounds[0] <= bounds[1]:
            yield "resampling_time_range", f"is {bounds}, must be (low, high) with 0 < low <= high [s]"


@configclass
class CommandManagerCfg:
    """Config of the command manager: a field for each term.

    Subclass it, or name them: ``CommandManagerCfg(NAME=CommandTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (CommandTermCfg,)


@configclass
class NullCommandCfg(CommandTermCfg):
    """No command."""

    resampling_time_range: tuple[AnyFloat, AnyFloat] = (math.inf, math.inf)


@configclass
class UniformVelocityCommandCfg(CommandTermCfg):
    """Velocity command drawn uniformly; a share of the environments turns to a heading, another stands."""

    @configclass
    class Ranges(_RangesCfg):
        """Bounds."""

        lin_vel_x: Range = MISSING
        """Forward velocity [m/s]."""
        lin_vel_y: Range = MISSING
        """Sideways velocity [m/s]."""
        ang_vel_z: Range = MISSING
        """Yaw rate [rad/s]."""
        heading: Range | None = None
        """Heading in the world [rad], for ``heading_command``."""

    heading_command: bool = False
    """A share of the environments turns to a heading rather than at a rate."""
    heading_control_stiffness: float = 1.0
    """Yaw rate for an error of one radian [1/s]."""
    rel_standing_envs: UnitFloat = 0.0
    """Share of the environments that stands."""
    rel_heading_envs: UnitFloat = 1.0
    """Share of the environments that turns to a heading, for ``heading_command``."""
    ranges: Ranges = MISSING
    """Bounds."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from CommandTermCfg.problems(self)
        if self.heading_command and self.ranges is not MISSING and self.ranges.heading is None:
            yield "ranges.heading", "is None, but heading_command is set; give bounds [rad]"


@configclass
class NormalVelocityCommandCfg(CommandTermCfg):
    """Velocity command drawn from a normal distribution about a mean whose sign is random."""

    @configclass
    class Ranges:
        """Distribution."""

        mean_vel: tuple[float, float, float] = MISSING
        """Means: forward, sideways [m/s], yaw rate [rad/s]."""
        std_vel: tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat] = MISSING
        """Standard deviations."""
        zero_prob: tuple[UnitFloat, UnitFloat, UnitFloat] = MISSING
        """Probabilities that a component is zero."""

    rel_standing_envs: UnitFloat = 0.0
    """Share of the environments that stands."""
    ranges: Ranges = MISSING
    """Distribution."""


@configclass
class UniformPoseCommandCfg(CommandTermCfg):
    """Pose command for a body, in the root's frame."""

    @configclass
    class Ranges(_RangesCfg):
        """Bounds."""

        pos_x: Range = MISSING
        """[m]"""
        pos_y: Range = MISSING
        """[m]"""
        pos_z: Range = MISSING
        """[m]"""
        roll: Range = MISSING
        """[rad]"""
        pitch: Range = MISSING
        """[rad]"""
        yaw: Range = MISSING
        """[rad]"""

    body_name: str = MISSING
    """Body that the policy moves to the pose."""
    make_quat_unique: bool = False
    """Give the quaternion ``w >= 0``."""
    ranges: Ranges = MISSING
    """Bounds."""


@configclass
class UniformPose2dCommandCfg(CommandTermCfg):
    """Command of a position on the ground, relative to the environment's origin, and of a heading."""

    @configclass
    class Ranges(_RangesCfg):
        """Bounds."""

        pos_x: Range = MISSING
        """[m]"""
        pos_y: Range = MISSING
        """[m]"""
        heading: Range = (-math.pi, math.pi)
        """[rad], without ``simple_heading``."""

    simple_heading: bool = False
    """Take the direction to the position as heading, or the opposite direction if that is the smaller turn."""
    ranges: Ranges = MISSING
    """Bounds."""


@configclass
class TerrainBasedPose2dCommandCfg(UniformPose2dCommandCfg):
    """Command of a position among the flat patches ``"target"`` of the environment's terrain tile, and of a heading."""

    @configclass
    class Ranges(_RangesCfg):
        """Bounds."""

        heading: Range = (-math.pi, math.pi)
        """[rad], without ``simple_heading``."""
        distance: Range = (0.0, 1.0e6)
        """Horizontal distance from the root [m]."""

    ranges: Ranges = Ranges()  # type: ignore[assignment]  # without bounds of the position
    """Bounds."""


@configclass
class MotionCommandCfg(CommandTermCfg):
    """Motion command: reference motions of a robot, joint positions and velocities of which are the command.

    An episode begins at a drawn frame, with the robot put there. Where episodes fail, more of them begin. A step later
    the robot is to be at the next frame; after the last one, :func:`motion_finished` is true.
    """

    resampling_time_range: tuple[AnyFloat, AnyFloat] = (math.inf, math.inf)
    motion_file: str | list[str] = MISSING
    """CSV or NPZ files, folders of them, or patterns; see :func:`stripe_newton.motions.read_motion`."""
    anchor_body_name: str = MISSING
    """Body at which the reference is aligned with the robot."""
    body_names: str | list[str] = [".*"]
    """Bodies of the metrics; rewards and terminations name theirs by ``asset_cfg``."""
    joint_names: list[str] | None = None
    """Names of the joints in the files' order. Default: the names in the file, or the robot's joints in its order."""
    quaternions: Literal["xyzw", "wxyz"] | None = None
    """Order of quaternions in the files. Default: (x, y, z, w) in CSV, (w, x, y, z) in NPZ."""
    motion_fps: AnyFloat | None = None
    """Frames a second of the files. Default: what the file or its name says."""
    pose_range: dict[str, Range] = {}
    """Noise of the root's pose at the start, by axis: x, y, z [m], roll, pitch, yaw [rad]."""
    velocity_range: dict[str, Range] = {}
    """Noise of the root's velocity at the start, by the same axes [m/s, rad/s]."""
    joint_position_range: Range = (0.0, 0.0)
    """Noise of the joint positions at the start [rad]."""
    sampling_mode: Literal["adaptive", "uniform", "start"] = "adaptive"
    """Frames at which episodes begin: by failures, all alike, or the first of a motion."""
    adaptive_kernel_size: int = 1
    """Bins over which a failure counts: that in which it happened, and those before."""
    adaptive_lambda: UnitFloat = 0.8
    """Factor by which it counts less from bin to bin."""
    adaptive_uniform_ratio: NonNegativeFloat = 0.1
    """Failures in a step that all bins together are given, so that none is forgotten."""
    adaptive_alpha: UnitFloat = 0.001
    """Share of a step in the averaged failures."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from CommandTermCfg.problems(self)
        if self.adaptive_kernel_size < 1:
            yield "adaptive_kernel_size", f"is {self.adaptive_kernel_size}, must be 1 or more"
