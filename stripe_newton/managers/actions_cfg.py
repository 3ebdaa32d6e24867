# SPDX-License-Identifier: Apache-2.0
"""Configs of action terms: joint positions, velocities and efforts, grippers, a car-like base, inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import warp as wp

from stripe_kernels.mdp import ACTIONS, DIFFERENTIAL_IK_METHODS, process_differential_ik
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.controllers import DifferentialIKControllerCfg
from stripe_newton.noise import NoiseCfg
from stripe_newton.value_types import AnyFloat, NonNegativeInt, PositiveInt

__all__ = [
    "ActionManagerCfg",
    "ActionTermCfg",
    "BinaryJointPositionActionCfg",
    "BinaryJointVelocityActionCfg",
    "DifferentialIKControllerCfg",
    "DifferentialInverseKinematicsActionCfg",
    "EMAJointPositionToLimitsActionCfg",
    "JointActionCfg",
    "JointEffortActionCfg",
    "JointPositionActionCfg",
    "JointPositionToLimitsActionCfg",
    "JointVelocityActionCfg",
    "NonHolonomicActionCfg",
    "RelativeJointPositionActionCfg",
]

PerJoint = float | Mapping[str, float] | Sequence[float]
"""A number for all joints, a mapping from joint-name expressions to numbers, or a number for each joint."""


def _numbers(value: PerJoint) -> Sequence[float]:
    return list(value.values()) if isinstance(value, Mapping) else value if isinstance(value, Sequence) else [value]


@configclass
class ActionTermCfg:
    """Config of an action term: ``process`` runs once a step, ``apply`` before the physics.

    Both are Warp functions, ``process(env, action, ..., processed)`` and ``apply(env, processed, robot, joint_ids)``,
    whose slices ``action`` and ``processed`` have ``action_size`` and ``processed_size`` numbers.
    """

    MAY_BE_NONE: ClassVar[bool] = True

    class_type: type | None = None
    """Class of a torch term, derived from :class:`ActionTerm`, made as ``class_type(cfg, env)``; the fields below, but
    for ``asset_name``, are then without effect. None for a term of Warp functions."""
    asset_name: str = "robot"
    """Asset that it moves."""
    joint_names: Sequence[str] = (".*",)
    """Expressions for the joints."""
    preserve_order: bool = False
    """Use the order of the expressions rather than that of the asset."""
    process: Callable[..., object] | None = None
    """Warp function that turns actions into processed actions."""
    apply: Callable[..., object] | None = None
    """Warp function that sets targets from processed actions."""
    reset: Callable[..., object] | None = None
    """Warp function ``(env, ..., processed)`` that runs where an episode begins."""
    action_size: PositiveInt | None = None
    """Number of actions; by default one for each joint."""
    processed_size: PositiveInt | None = None
    """Number of processed actions; by default one for each joint."""
    per_substep: bool = True
    """Run ``apply`` before each physics step. False runs it once, which is enough if it does not read the state."""
    params: dict[str, Any] = {}
    """Further arguments of the functions."""
    noise: NoiseCfg | None = None
    """Noise on the raw actions."""
    delay_min_lag: NonNegativeInt = 0
    """Least delay of the actions [steps]."""
    delay_max_lag: NonNegativeInt = 0
    """Largest delay [steps]; each episode draws one within the bounds."""

    @property
    def is_users(self) -> bool:
        """Whether a class of the user computes it, rather than Warp functions."""
        return self.class_type is not None and not getattr(self.class_type, "is_fused", bool)()

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        """Functions of the package for its kind, used where the config names none."""
        return {}

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0 <= self.delay_min_lag <= self.delay_max_lag:
            bounds = f"({self.delay_min_lag}, {self.delay_max_lag})"
            yield "delay_min_lag", f"lags are {bounds}, must be 0 <= delay_min_lag <= delay_max_lag"


@configclass
class ActionManagerCfg:
    """Config of the action manager: a field for each term.

    Subclass it, or name them: ``ActionManagerCfg(NAME=ActionTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (ActionTermCfg,)


@configclass
class JointActionCfg(ActionTermCfg):
    """Config of an action term on joints: one number for each joint, scaled, shifted and clipped."""

    kind: str = ""
    """Name in ``stripe_kernels.mdp.ACTIONS``."""
    per_substep: bool = False
    scale: PerJoint = 1.0
    """Factor on the actions."""
    offset: PerJoint = 0.0
    """Added to the scaled actions, in the unit of the targets."""
    clip: Mapping[str, tuple[AnyFloat, AnyFloat]] | None = None
    """Bounds of the processed actions by joint-name expression."""

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        return ACTIONS[self.kind]._asdict() if self.kind in ACTIONS else {}

    @property
    def switches(self) -> dict[str, bool]:
        """Boolean arguments of its functions."""
        return {}

    @property
    def numbers(self) -> dict[str, PerJoint]:
        """Numeric arguments of its functions, one value for each joint."""
        return {"scale": self.scale, "offset": self.offset, "alpha": 1.0}

    @property
    def positions(self) -> dict[str, Mapping[str, float]]:
        """Numeric arguments of its functions that must be given for every joint."""
        return {}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from ActionTermCfg.problems(self)
        if self.kind not in ACTIONS and None in (self.process, self.apply) and not self.is_users:
            kinds = ", ".join(ACTIONS)
            yield "kind", f"is {self.kind!r}, must be one of {kinds}, unless 'process' and 'apply' are given"
        for name in ("scale", "offset"):
            if not all(map(math.isfinite, _numbers(getattr(self, name)))):
                yield name, f"is {getattr(self, name)}, must be finite"
        for key, (low, high) in (self.clip or {}).items():
            if not low <= high:
                yield f"clip[{key!r}]", f"is {(low, high)}, must be (low, high) with low <= high"


@configclass
class JointPositionActionCfg(JointActionCfg):
    """Position targets ``offset + scale * action`` [m or rad]; by default the offset is the default position."""

    kind: str = "JointPosition"
    use_default_offset: bool = True
    """Use the default positions in place of ``offset``."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"use_default_offset": self.use_default_offset}


@configclass
class RelativeJointPositionActionCfg(JointActionCfg):
    """Position targets relative to the joint positions before each physics step [m or rad]."""

    kind: str = "RelativeJointPosition"
    per_substep: bool = True
    use_zero_offset: bool = True
    """Use zero in place of ``offset``."""

    @property
    def numbers(self) -> dict[str, PerJoint]:
        return super().numbers | ({"offset": 0.0} if self.use_zero_offset else {})


@configclass
class JointVelocityActionCfg(JointActionCfg):
    """Velocity targets [m/s or rad/s]."""

    kind: str = "JointVelocity"
    use_default_offset: bool = True
    """Use the default velocities in place of ``offset``."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"use_default_offset": self.use_default_offset}


@configclass
class JointEffortActionCfg(JointActionCfg):
    """Effort targets [N or N m]."""

    kind: str = "JointEffort"


@configclass
class JointPositionToLimitsActionCfg(JointActionCfg):
    """Position targets [m or rad]; actions of -1 and 1 are the lower and upper soft limits."""

    kind: str = "JointPositionToLimits"
    rescale_to_limits: bool = True
    """Map actions from [-1, 1] to the limits; otherwise they are positions."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"rescale_to_limits": self.rescale_to_limits}


@configclass
class EMAJointPositionToLimitsActionCfg(JointPositionToLimitsActionCfg):
    """Position targets between the soft limits with an exponential moving average over the steps."""

    kind: str = "EMAJointPositionToLimits"
    alpha: PerJoint = 1.0
    """Weight of the new target in the average; 1 does not average."""

    @property
    def numbers(self) -> dict[str, PerJoint]:
        return super().numbers | {"alpha": self.alpha}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from JointActionCfg.problems(self)
        if not all(0.0 <= a <= 1.0 for a in _numbers(self.alpha)):
            yield "alpha", f"is {self.alpha}, must be in [0, 1]"


@configclass
class BinaryJointPositionActionCfg(JointActionCfg):
    """Position targets of a gripper from one number: 0 or more opens it, less closes it."""

    kind: str = "BinaryJointPosition"
    action_size: PositiveInt | None = 1
    open_command_expr: Mapping[str, float] = MISSING
    """Positions when open, by expression [m or rad]."""
    close_command_expr: Mapping[str, float] = MISSING
    """Positions when closed, by expression [m or rad]."""

    @property
    def positions(self) -> dict[str, Mapping[str, float]]:
        return {"open_command": self.open_command_expr, "close_command": self.close_command_expr}


@configclass
class BinaryJointVelocityActionCfg(BinaryJointPositionActionCfg):
    """Velocity targets of a gripper from one number [m/s or rad/s]: 0 or more opens it, less closes it."""

    kind: str = "BinaryJointVelocity"


@configclass
class NonHolonomicActionCfg(JointActionCfg):
    """Velocity targets of a base that moves as a car, without sliding: forward speed [m/s] and rate of turn [rad/s].

    ``clip`` bounds the speed by the name of the joint along x, and the rate of turn by that of the joint about z.
    """

    kind: str = "NonHolonomic"
    per_substep: bool = True
    action_size: PositiveInt | None = 2
    processed_size: PositiveInt | None = 2
    body_name: str = MISSING
    """Body whose heading is the forward direction."""
    x_joint_name: str = MISSING
    """Joint along x."""
    y_joint_name: str = MISSING
    """Joint along y."""
    yaw_joint_name: str = MISSING
    """Joint about z."""
    scale: tuple[float, float] = (1.0, 1.0)
    """Factors on forward speed and rate of turn."""
    offset: tuple[float, float] = (0.0, 0.0)
    """Added to forward speed [m/s] and rate of turn [rad/s]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        # The base also takes one number for all, and numbers by the names of joints.
        for name in ("scale", "offset"):
            value = getattr(self, name)
            if not isinstance(value, (tuple, list)) or len(value) != 2:
                yield name, f"is {value!r}, must be two numbers, for forward speed and rate of turn"
        yield from JointActionCfg.problems(self)


@configclass
class DifferentialInverseKinematicsActionCfg(ActionTermCfg):
    """Position targets [m or rad] that move a body to a commanded pose in the root's frame, by inverse kinematics.

    Targets are computed anew before each physics step.

    Commands are a position [m] and, in ``"pose"`` mode, a quaternion (x, y, z, w); relative ones are a shift [m] and a
    rotation vector [rad] along the root's axes. The processed actions are the desired pose, 7 numbers.
    """

    @configclass
    class OffsetCfg:
        """Frame fixed to the body."""

        pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Origin in the body's frame [m]."""
        rot: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
        """Quaternion (x, y, z, w) to the body's frame."""

        @property
        def rot_xyzw(self) -> tuple[float, float, float, float]:
            """The rotation as the package reads it, (x, y, z, w)."""
            return self.rot

        def problems(self) -> Iterator[tuple[str, str]]:
            if len(self.pos) != 3 or not all(map(math.isfinite, self.pos)):
                yield "pos", f"is {self.pos}, must be three finite numbers"
            if len(self.rot) != 4 or not math.isclose(math.hypot(*self.rot), 1.0, abs_tol=1e-3):
                yield "rot", f"is {self.rot}, must be a unit quaternion (x, y, z, w)"

    scalar_first: ClassVar[bool] = False
    """Whether quaternions among the actions are (w, x, y, z)."""
    process: Callable[..., object] | None = process_differential_ik
    body_name: str = MISSING
    """Body that moves."""
    body_offset: OffsetCfg | None = None
    """Frame on the body that takes the pose; None for the frame of the body."""
    scale: float | Sequence[float] = 1.0
    """Factor on the actions: one for all, or one for each."""
    controller: DifferentialIKControllerCfg = MISSING
    """Kind of command and method of the inverse kinematics."""

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        return {"apply": DIFFERENTIAL_IK_METHODS.get(self.controller.ik_method)}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from ActionTermCfg.problems(self)
        if not all(map(math.isfinite, _numbers(self.scale))):
            yield "scale", f"is {self.scale}, must be finite"
        elif self.controller is not MISSING and len(_numbers(self.scale)) not in (1, self.controller.action_dim):
            yield "scale", f"has {len(_numbers(self.scale))} numbers, must have {self.controller.action_dim}"
