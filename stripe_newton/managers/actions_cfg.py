# SPDX-License-Identifier: Apache-2.0
"""Configs of action terms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg

__all__ = [
    "ActionTermCfg",
    "BinaryJointPositionActionCfg",
    "BinaryJointVelocityActionCfg",
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


def _numbers(value: Any) -> Sequence[float]:
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
    process: Callable[..., Any] | None = None
    """Warp function that turns actions into commands."""
    apply: Callable[..., Any] | None = None
    """Warp function that sets targets."""
    reset: Callable[..., Any] | None = None
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

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0 <= self.delay_min_lag <= self.delay_max_lag:
            bounds = f"({self.delay_min_lag}, {self.delay_max_lag})"
            yield "delay_min_lag", f"lags are {bounds}, must be 0 <= delay_min_lag <= delay_max_lag"


@configclass
class JointActionCfg(ActionTermCfg):
    """What action terms on joints have."""

    kind: str = ""
    """Name in ``stripe_kernels.mdp.ACTIONS``."""
    per_substep: bool = False
    scale: PerJoint = 1.0
    """Factor on the actions."""
    offset: PerJoint = 0.0
    """Added to the scaled actions, in the unit of the command."""
    clip: Mapping[str, tuple[float, float]] | None = None
    """Bounds of the commands by joint-name expression."""

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


@configclass
class RelativeJointPositionActionCfg(JointActionCfg):
    """Position targets relative to the positions before each physics step [m or rad]."""

    kind: str = "RelativeJointPosition"
    per_substep: bool = True
    use_zero_offset: bool = True
    """Whether zero stands in for ``offset``."""


@configclass
class JointVelocityActionCfg(JointActionCfg):
    """Velocity targets [m/s or rad/s]."""

    kind: str = "JointVelocity"
    use_default_offset: bool = True
    """Whether the default velocities stand in for ``offset``."""


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


@configclass
class EMAJointPositionToLimitsActionCfg(JointPositionToLimitsActionCfg):
    """The same, averaged over the steps."""

    kind: str = "EMAJointPositionToLimits"
    alpha: PerJoint = 1.0
    """Weight of the new target; 1 does not average."""

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
