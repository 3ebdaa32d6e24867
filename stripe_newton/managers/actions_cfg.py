# SPDX-License-Identifier: Apache-2.0
"""Configs of action terms: joint positions, velocities and efforts, grippers, a car-like base, inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import warp as wp

from stripe_kernels.mdp import ACTIONS, DIFFERENTIAL_IK_METHODS, process_differential_ik
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg

__all__ = [
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
"""One number for all joints, numbers by joint-name expression, or one for each joint."""


def _numbers(value: PerJoint) -> Sequence[float]:
    return list(value.values()) if isinstance(value, Mapping) else value if isinstance(value, Sequence) else [value]


@configclass
class ActionTermCfg:
    """An action term: ``process`` once a step, ``apply`` before the physics.

    Both are Warp functions, ``process(env, action, ..., processed)`` and ``apply(env, processed, robot, joint_ids)``,
    whose slices ``action`` and ``processed`` have ``action_size`` and ``processed_size`` numbers.
    """

    asset_name: str = "robot"
    """Asset it moves."""
    joint_names: Sequence[str] = (".*",)
    """Expressions for the joints."""
    preserve_order: bool = False
    """Order of the expressions rather than of the asset."""
    process: Callable[..., object] | None = None
    """Warp function that turns actions into commands."""
    apply: Callable[..., object] | None = None
    """Warp function that sets targets."""
    reset: Callable[..., object] | None = None
    """Warp function ``(env, ..., processed)`` that starts an episode."""
    action_size: int | None = None
    """Numbers of the policy; by default one a joint."""
    processed_size: int | None = None
    """Numbers of the commands; by default one a joint."""
    per_substep: bool = True
    """Whether ``apply`` runs before each physics step, rather than once, which is enough where it does not depend on
    the state."""
    params: dict[str, Any] = {}
    """Further arguments of the functions."""
    noise: NoiseCfg | None = None
    """Noise on the raw actions."""
    delay_min_lag: int = 0
    """Least delay of the actions [steps]."""
    delay_max_lag: int = 0
    """Largest delay [steps]; each episode draws one within the bounds."""

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        """Functions that come with the package for its kind, where the config names none of its own."""
        return {}

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0 <= self.delay_min_lag <= self.delay_max_lag:
            bounds = f"({self.delay_min_lag}, {self.delay_max_lag})"
            yield "delay_min_lag", f"lags are {bounds}, must be 0 <= delay_min_lag <= delay_max_lag"


@configclass
class JointActionCfg(ActionTermCfg):
    """An action term on joints: numbers that are scaled, shifted and clipped, one for each joint."""

    kind: str = ""
    """Name in ``stripe_kernels.mdp.ACTIONS``."""
    per_substep: bool = False
    scale: PerJoint = 1.0
    """Factor on the actions."""
    offset: PerJoint = 0.0
    """Added to the scaled actions, in the unit of the command."""
    clip: Mapping[str, tuple[float, float]] | None = None
    """Bounds of the commands by joint-name expression."""

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        return ACTIONS[self.kind]._asdict() if self.kind in ACTIONS else {}

    @property
    def switches(self) -> dict[str, bool]:
        """Truth values among the arguments of its functions."""
        return {}

    @property
    def numbers(self) -> dict[str, PerJoint]:
        """Numbers among the arguments of its functions, which have one for each joint."""
        return {"scale": self.scale, "offset": self.offset, "alpha": 1.0}

    @property
    def positions(self) -> dict[str, Mapping[str, float]]:
        """Numbers by joint among the arguments of its functions, which every joint must have."""
        return {}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from ActionTermCfg.problems(self)
        for name in ("scale", "offset"):
            if not all(map(math.isfinite, _numbers(getattr(self, name)))):
                yield name, f"is {getattr(self, name)}, must be finite"
        for key, (low, high) in (self.clip or {}).items():
            if not low <= high:
                yield f"clip[{key!r}]", f"is {(low, high)}, must be (low, high) with low <= high"


@configclass
class JointPositionActionCfg(JointActionCfg):
    """Position targets: ``scale * action`` from the default positions [m or rad]."""

    kind: str = "JointPosition"
    use_default_offset: bool = True
    """Whether the default positions stand in for ``offset``."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"use_default_offset": self.use_default_offset}


@configclass
class RelativeJointPositionActionCfg(JointActionCfg):
    """Position targets relative to the positions before each physics step [m or rad]."""

    kind: str = "RelativeJointPosition"
    per_substep: bool = True
    use_zero_offset: bool = True
    """Whether zero stands in for ``offset``."""

    @property
    def numbers(self) -> dict[str, PerJoint]:
        return super().numbers | ({"offset": 0.0} if self.use_zero_offset else {})


@configclass
class JointVelocityActionCfg(JointActionCfg):
    """Velocity targets [m/s or rad/s]."""

    kind: str = "JointVelocity"
    use_default_offset: bool = True
    """Whether the default velocities stand in for ``offset``."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"use_default_offset": self.use_default_offset}


@configclass
class JointEffortActionCfg(JointActionCfg):
    """Effort targets [N or N m]."""

    kind: str = "JointEffort"


@configclass
class JointPositionToLimitsActionCfg(JointActionCfg):
    """Position targets, -1 and 1 at the soft limits [m or rad]."""

    kind: str = "JointPositionToLimits"
    rescale_to_limits: bool = True
    """Whether actions are mapped to the limits; otherwise they are positions."""

    @property
    def switches(self) -> dict[str, bool]:
        return {"rescale_to_limits": self.rescale_to_limits}


@configclass
class EMAJointPositionToLimitsActionCfg(JointPositionToLimitsActionCfg):
    """The same, averaged over the steps."""

    kind: str = "EMAJointPositionToLimits"
    alpha: PerJoint = 1.0
    """Weight of the new target; 1 does not average."""

    @property
    def numbers(self) -> dict[str, PerJoint]:
        return super().numbers | {"alpha": self.alpha}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from JointActionCfg.problems(self)
        if not all(0.0 <= a <= 1.0 for a in _numbers(self.alpha)):
            yield "alpha", f"is {self.alpha}, must be in [0, 1]"


@configclass
class BinaryJointPositionActionCfg(JointActionCfg):
    """One number opens (0 or more) or closes (less) a gripper: position targets."""

    kind: str = "BinaryJointPosition"
    action_size: int | None = 1
    open_command_expr: Mapping[str, float] = MISSING
    """Positions when open, by expression [m or rad]."""
    close_command_expr: Mapping[str, float] = MISSING
    """Positions when closed, by expression [m or rad]."""

    @property
    def positions(self) -> dict[str, Mapping[str, float]]:
        return {"open_command": self.open_command_expr, "close_command": self.close_command_expr}


@configclass
class BinaryJointVelocityActionCfg(BinaryJointPositionActionCfg):
    """One number opens or closes a gripper: velocity targets [m/s or rad/s]."""

    kind: str = "BinaryJointVelocity"


@configclass
class NonHolonomicActionCfg(JointActionCfg):
    """Drive a base as a car that cannot slide: forward speed [m/s] and turn [rad/s].

    ``clip`` bounds the former by the name of the joint along x, the latter by that of the joint about z.
    """

    kind: str = "NonHolonomic"
    per_substep: bool = True
    action_size: int | None = 2
    processed_size: int | None = 2
    body_name: str = MISSING
    """Body whose heading counts."""
    x_joint_name: str = MISSING
    """Joint along x."""
    y_joint_name: str = MISSING
    """Joint along y."""
    yaw_joint_name: str = MISSING
    """Joint about z."""
    scale: tuple[float, float] = (1.0, 1.0)
    """Factors on forward speed and turn."""
    offset: tuple[float, float] = (0.0, 0.0)
    """Added to them."""


_IK_PARAMS: dict[str, dict[str, float]] = {
    "pinv": {"k_val": 1.0},
    "svd": {"k_val": 1.0, "min_singular_value": 1e-5},
    "trans": {"k_val": 1.0},
    "dls": {"lambda_val": 0.01},
}


@configclass
class DifferentialIKControllerCfg:
    """How joints follow the pose of a body."""

    command_type: str = MISSING
    """``"position"`` or ``"pose"``: whether the rotation is commanded too."""
    use_relative_mode: bool = False
    """Whether commands are changes of the present pose, rather than poses."""
    ik_method: str = MISSING
    """``"pinv"`` (pseudo-inverse of the Jacobian), ``"svd"`` (the same without small singular values), ``"trans"``
    (its transpose) or ``"dls"`` (damped least squares)."""
    ik_params: dict[str, float] | None = None
    """Numbers of the method where they are not 1: ``k_val``, the factor of ``pinv``, ``svd`` and ``trans``;
    ``min_singular_value`` of ``svd`` (1e-5); ``lambda_val``, the damping of ``dls`` (0.01)."""

    @property
    def action_dim(self) -> int:
        """Numbers of a command: position, rotation vector of a change, or quaternion (x, y, z, w)."""
        return 3 if self.command_type == "position" else 6 if self.use_relative_mode else 7

    @property
    def numbers(self) -> dict[str, float]:
        """``ik_params`` with what they leave out."""
        return _IK_PARAMS.get(self.ik_method, {}) | (self.ik_params or {})

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.command_type not in ("position", "pose", MISSING):
            yield "command_type", f"is '{self.command_type}', must be 'position' or 'pose'"
        if self.ik_method is MISSING:
            return
        if self.ik_method not in _IK_PARAMS:
            yield "ik_method", f"is '{self.ik_method}', must be one of {', '.join(map(repr, _IK_PARAMS))}"
            return
        known = _IK_PARAMS[self.ik_method]
        for name, value in (self.ik_params or {}).items():
            if name not in known:
                yield f"ik_params[{name!r}]", f"'{self.ik_method}' has no such number, it takes {', '.join(known)}"
            elif not (math.isfinite(value) and value > 0.0):
                yield f"ik_params[{name!r}]", f"is {value}, must be above 0 and finite"


@configclass
class DifferentialInverseKinematicsActionCfg(ActionTermCfg):
    """Move a body: position targets [m or rad] of the joints, anew before each physics step, by which it takes the
    commanded pose in the root's frame.

    Commands are a position [m] and, in ``"pose"`` mode, a quaternion (x, y, z, w); relative ones are a shift [m] and a
    rotation vector [rad] along the root's axes. The processed actions are the desired pose, 7 numbers.
    """

    @configclass
    class OffsetCfg:
        """A frame fixed to the body."""

        pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Origin in the body's frame [m]."""
        rot: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
        """Quaternion (x, y, z, w) to the body's frame."""

        def problems(self) -> Iterator[tuple[str, str]]:
            if len(self.pos) != 3 or not all(map(math.isfinite, self.pos)):
                yield "pos", f"is {self.pos}, must be three finite numbers"
            if len(self.rot) != 4 or not math.isclose(math.hypot(*self.rot), 1.0, abs_tol=1e-3):
                yield "rot", f"is {self.rot}, must be a unit quaternion (x, y, z, w)"

    process: Callable[..., object] | None = process_differential_ik
    body_name: str = MISSING
    """The body."""
    body_offset: OffsetCfg | None = None
    """Frame of the body that is moved; None for the body's own."""
    scale: float | Sequence[float] = 1.0
    """Factor on the actions; one number, or one for each."""
    controller: DifferentialIKControllerCfg = MISSING
    """How the joints follow."""

    @property
    def known_functions(self) -> dict[str, wp.Function | None]:
        return {"apply": DIFFERENTIAL_IK_METHODS.get(self.controller.ik_method)}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from ActionTermCfg.problems(self)
        if not all(map(math.isfinite, _numbers(self.scale))):
            yield "scale", f"is {self.scale}, must be finite"
        elif self.controller is not MISSING and len(_numbers(self.scale)) not in (1, self.controller.action_dim):
            yield "scale", f"has {len(_numbers(self.scale))} numbers, must have {self.controller.action_dim}"
