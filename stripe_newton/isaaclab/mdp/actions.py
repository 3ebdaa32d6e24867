# SPDX-License-Identifier: Apache-2.0
"""Action terms of ``isaaclab.envs.mdp``: configs and classes.

Those of the package's kinds are fused by the manager. Their classes can be made and called from torch as well, which
terms that drive other terms do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import ActionTerm, KernelActionTerm, TermEnv
from stripe_newton.managers import actions_cfg as native
from stripe_newton.matching import match_names, match_values

from ..term_configs import ActionTermCfg
from ..wxyz_config import WxyzRot

__all__ = [
    "AbsBinaryJointPositionAction",
    "AbsBinaryJointPositionActionCfg",
    "BinaryJointAction",
    "BinaryJointActionCfg",
    "BinaryJointPositionAction",
    "BinaryJointPositionActionCfg",
    "BinaryJointVelocityAction",
    "BinaryJointVelocityActionCfg",
    "DifferentialInverseKinematicsAction",
    "DifferentialInverseKinematicsActionCfg",
    "EMAJointPositionToLimitsAction",
    "EMAJointPositionToLimitsActionCfg",
    "JointAction",
    "JointActionCfg",
    "JointEffortAction",
    "JointEffortActionCfg",
    "JointPositionAction",
    "JointPositionActionCfg",
    "JointPositionToLimitsAction",
    "JointPositionToLimitsActionCfg",
    "JointVelocityAction",
    "JointVelocityActionCfg",
    "NonHolonomicAction",
    "NonHolonomicActionCfg",
    "RelativeJointPositionAction",
    "RelativeJointPositionActionCfg",
]

NOT_DRAWN = {"debug_vis": "actions are not drawn"}
Quaternion = tuple[float, float, float, float]


class JointAction(KernelActionTerm):
    """Action term of kernels on joints."""

    @property
    def _joint_ids(self) -> list[int]:
        """Joints of the asset that it moves."""
        return self._source.term.joint_ids

    @property
    def _joint_names(self) -> list[str]:
        """Their names."""
        names = self._asset.names_of("joint") or []
        return [names[i] for i in self._joint_ids]

    @property
    def _num_joints(self) -> int:
        """Their number."""
        return len(self._joint_ids)

    @property
    def _raw_actions(self) -> torch.Tensor:
        """Actions of the last step."""
        return self.raw_actions

    @property
    def _processed_actions(self) -> torch.Tensor:
        """Actions after scale, offset and clip."""
        return self.processed_actions


class JointPositionAction(JointAction):
    """Position targets."""


class RelativeJointPositionAction(JointAction):
    """Position targets relative to the joint positions."""


class JointVelocityAction(JointAction):
    """Velocity targets."""


class JointEffortAction(JointAction):
    """Effort targets."""


class JointPositionToLimitsAction(JointAction):
    """Position targets between the soft limits."""


class EMAJointPositionToLimitsAction(JointPositionToLimitsAction):
    """Position targets between the soft limits, averaged over the steps."""


class BinaryJointAction(JointAction):
    """Targets of a gripper that is open or closed."""


class BinaryJointPositionAction(BinaryJointAction):
    """Position targets of a gripper."""


class BinaryJointVelocityAction(BinaryJointAction):
    """Velocity targets of a gripper."""


class NonHolonomicAction(JointAction):
    """Velocity targets of a base that moves as a car."""


class DifferentialInverseKinematicsAction(JointAction):
    """Position targets that move a body to a pose; absolute commands have quaternions (w, x, y, z)."""

    @property
    def processed_actions(self) -> torch.Tensor:
        """Scaled actions, shape ``(num_envs, action_dim)``."""
        return self.raw_actions * torch.tensor(self._source.term.values["scale"], device=self.device)


@configclass
class JointActionCfg(native.JointActionCfg):
    """:class:`stripe_newton.envs.mdp.JointActionCfg`."""

    class_type: type | None = MISSING
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING
    debug_vis: bool = False
    IGNORED: ClassVar[dict[str, str]] = NOT_DRAWN


@configclass
class _NamedJoints:
    """Fields without the package's defaults, as Isaac Lab has none; before the package's config in a list of bases."""

    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class JointPositionActionCfg(_NamedJoints, native.JointPositionActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.JointPositionActionCfg`."""

    class_type: type | None = JointPositionAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class RelativeJointPositionActionCfg(_NamedJoints, native.RelativeJointPositionActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.RelativeJointPositionActionCfg`."""

    class_type: type | None = RelativeJointPositionAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class JointVelocityActionCfg(_NamedJoints, native.JointVelocityActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.JointVelocityActionCfg`."""

    class_type: type | None = JointVelocityAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class JointEffortActionCfg(_NamedJoints, native.JointEffortActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.JointEffortActionCfg`."""

    class_type: type | None = JointEffortAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class JointPositionToLimitsActionCfg(_NamedJoints, native.JointPositionToLimitsActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.JointPositionToLimitsActionCfg`."""

    class_type: type | None = JointPositionToLimitsAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class EMAJointPositionToLimitsActionCfg(_NamedJoints, native.EMAJointPositionToLimitsActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.EMAJointPositionToLimitsActionCfg`."""

    class_type: type | None = EMAJointPositionToLimitsAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class BinaryJointActionCfg(_NamedJoints, native.BinaryJointPositionActionCfg, JointActionCfg):
    """Base of configs of grippers."""

    class_type: type | None = MISSING
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class BinaryJointPositionActionCfg(BinaryJointActionCfg):
    """:class:`stripe_newton.envs.mdp.BinaryJointPositionActionCfg`."""

    class_type: type | None = BinaryJointPositionAction


@configclass
class BinaryJointVelocityActionCfg(_NamedJoints, native.BinaryJointVelocityActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.BinaryJointVelocityActionCfg`."""

    class_type: type | None = BinaryJointVelocityAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING


@configclass
class NonHolonomicActionCfg(native.NonHolonomicActionCfg, JointActionCfg):
    """:class:`stripe_newton.envs.mdp.NonHolonomicActionCfg`."""

    class_type: type | None = NonHolonomicAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = (".*",)


@configclass
class BodyOffsetCfg(WxyzRot, native.DifferentialInverseKinematicsActionCfg.OffsetCfg):
    """Frame fixed to a body; ``rot`` is (w, x, y, z)."""

    rot: Quaternion = (1.0, 0.0, 0.0, 0.0)


@configclass
class DifferentialInverseKinematicsActionCfg(native.DifferentialInverseKinematicsActionCfg):
    """:class:`stripe_newton.envs.mdp.DifferentialInverseKinematicsActionCfg` with quaternions (w, x, y, z)."""

    OffsetCfg: ClassVar[type[BodyOffsetCfg]] = BodyOffsetCfg
    scalar_first: ClassVar[bool] = True
    class_type: type | None = DifferentialInverseKinematicsAction
    asset_name: str = MISSING
    body_name: str | list[str] = MISSING  # type: ignore[assignment]  # Isaac Lab takes any expressions of one body
    joint_names: Sequence[str] = MISSING
    debug_vis: bool = False
    clip: dict[str, tuple[float, float]] | None = None
    IGNORED: ClassVar[dict[str, str]] = NOT_DRAWN | {"clip": "commands of poses are not clipped"}


# -- a gripper that follows a threshold


class AbsBinaryJointPositionAction(ActionTerm):
    """Position targets of a gripper that opens or closes where a number passes a threshold."""

    cfg: AbsBinaryJointPositionActionCfg

    def __init__(self, cfg: AbsBinaryJointPositionActionCfg, env: TermEnv):
        super().__init__(cfg, env)
        self._joint_ids, self._joint_names = match_names(cfg.joint_names, self._asset.names_of("joint") or [])
        self._raw_actions = torch.zeros(self.num_envs, 1, device=self.device)
        self._open_command, self._close_command = (
            self._positions(name) for name in ("open_command_expr", "close_command_expr")
        )
        self._processed_actions = self._close_command.repeat(self.num_envs, 1)

    def _positions(self, name: str) -> torch.Tensor:
        """Positions of a field, one for each joint."""
        found = match_values(getattr(self.cfg, name), self._joint_names, what="joint")
        missing = [n for i, n in enumerate(self._joint_names) if i not in found]
        if missing:
            raise ValueError(f"{name} has no value for {', '.join(missing)}")
        return torch.tensor([found[i] for i in range(len(self._joint_names))], device=self.device)

    @property
    def action_dim(self) -> int:
        """One number."""
        return 1

    @property
    def raw_actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, 1)``."""
        return self._raw_actions

    @property
    def processed_actions(self) -> torch.Tensor:
        """Positions [m or rad], shape ``(num_envs, num_joints)``."""
        return self._processed_actions

    def process_actions(self, actions: torch.Tensor) -> None:
        """Open where the action is above the threshold, or below it without ``positive_threshold``."""
        self._raw_actions[:] = actions
        threshold = self.cfg.threshold
        opens = actions > threshold if self.cfg.positive_threshold else actions < threshold
        self._processed_actions = torch.where(opens, self._open_command, self._close_command)

    def apply_actions(self) -> None:
        """Set the position targets."""
        self._asset.set_joint_position_target(self._processed_actions, joint_ids=self._joint_ids)  # type: ignore[attr-defined]  # an articulation

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Set the actions to zero."""
        self._raw_actions[slice(None) if env_ids is None else env_ids] = 0.0


@configclass
class AbsBinaryJointPositionActionCfg(ActionTermCfg):
    """Config of :class:`AbsBinaryJointPositionAction`."""

    class_type: type | None = AbsBinaryJointPositionAction
    joint_names: Sequence[str] = MISSING
    open_command_expr: dict[str, float] = MISSING
    """Positions when open, by expression [m or rad]."""
    close_command_expr: dict[str, float] = MISSING
    """Positions when closed, by expression [m or rad]."""
    threshold: float = 0.5
    """Number that the actions are compared with."""
    positive_threshold: bool = True
    """Open above the threshold; otherwise below."""
