# SPDX-License-Identifier: Apache-2.0
"""Operational space action: joint efforts that move a body to commanded poses, or press with it, as an action term."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, TypeVar

import torch

from stripe_newton.assets import Articulation
from stripe_newton.assets.asset_base import BoundAsset
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.controllers import OperationalSpaceController, OperationalSpaceControllerCfg
from stripe_newton.math import combine_frame_transforms, matrix_from_quat, quat_apply_inverse, subtract_frame_transforms
from stripe_newton.sensors import ContactSensor

from .action_term import ActionTerm
from .actions_cfg import ActionTermCfg, DifferentialInverseKinematicsActionCfg
from .term_class import TermEnv

__all__ = ["OperationalSpaceControllerAction", "OperationalSpaceControllerActionCfg"]

Found = TypeVar("Found")

_SMALLEST = 1e-6
"""Length of four numbers below which they are no rotation."""


class OperationalSpaceControllerAction(ActionTerm):
    """Joint efforts of a :class:`stripe_newton.controllers.OperationalSpaceController`, computed before each physics
    step.

    Actions are the controller's command, scaled. Quaternions among them are normalised; where they have no length the
    body keeps its orientation. The Jacobian and the velocity are those of the frame's origin relative to the root.
    """

    cfg: OperationalSpaceControllerActionCfg

    def __init__(self, cfg: OperationalSpaceControllerActionCfg, env: TermEnv):
        """Find joints, body, task frame and contact sensor.

        Raises:
            ValueError: one of them is not there, or has another type; the message says which.
        """
        super().__init__(cfg, env)
        self._robot = _instance_of(Articulation, env.scene[cfg.asset_name], "asset_name", cfg.asset_name)
        joints, self._joint_names = self._robot.find_joints(cfg.joint_names, preserve_order=cfg.preserve_order)
        self._joint_ids = torch.tensor(joints, device=self.device)
        (self._body, *others), names = self._robot.find_bodies(cfg.body_name)
        if others:
            raise ValueError(f"body_name '{cfg.body_name}' matches {', '.join(names)}, must match one body")
        self._controller = OperationalSpaceController(cfg.controller_cfg, self.num_envs, self.device)
        self._task = self._find_task(cfg, env)
        self._sensor, self._sensor_body = self._find_sensor(cfg, env)
        offset = cfg.body_offset or DifferentialInverseKinematicsActionCfg.OffsetCfg()
        self._offset_pos = torch.tensor(offset.pos, device=self.device).repeat(self.num_envs, 1)
        self._offset_quat = torch.tensor(offset.rot_xyzw, device=self.device).repeat(self.num_envs, 1)
        self._scale, self._bounds = self._scale_and_bounds()
        self._raw_actions = torch.zeros(self.num_envs, self.action_dim, device=self.device)
        self._processed_actions = torch.zeros_like(self._raw_actions)

    @property
    def action_dim(self) -> int:
        """Size of the controller's command."""
        return self._controller.action_dim

    @property
    def raw_actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, action_dim)``."""
        return self._raw_actions

    @property
    def processed_actions(self) -> torch.Tensor:
        """Scaled actions with gains within their limits, shape ``(num_envs, action_dim)``."""
        return self._processed_actions

    def process_actions(self, actions: torch.Tensor) -> None:
        """Give the command to the controller."""
        self._raw_actions[:] = actions
        torch.clamp(actions * self._scale, *self._bounds, out=self._processed_actions)
        pose = self._pose()
        self._controller.set_command(self._command(pose), pose, self._task_pose())

    def apply_actions(self) -> None:
        """Compute the efforts from the present state, and set them."""
        jacobian, velocity = self._motion()
        data, cfg = self._robot.native_data, self.cfg.controller_cfg
        columns = self._joint_ids + (0 if self._robot.is_fixed_base else 6)
        mass = gravity = None
        if cfg.inertial_dynamics_decoupling or cfg.nullspace_control != "none":
            mass = self._robot.dynamics.mass_matrices()[:, columns][:, :, columns]
        if cfg.gravity_compensation:
            gravity = self._robot.dynamics.gravity_compensation()[:, columns]
        efforts = self._controller.compute(
            jacobian[:, :, columns],
            self._pose(),
            velocity,
            self._force(),
            mass,
            gravity,
            data.joint_pos[:, self._joint_ids],
            data.joint_vel[:, self._joint_ids],
            self._wanted_joints(),
        )
        self._robot.set_joint_effort_target(efforts, joint_ids=self._joint_ids)

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Set the actions to zero."""
        self._raw_actions[slice(None) if env_ids is None else env_ids] = 0.0

    # ---- what the config names

    @staticmethod
    def _find_task(cfg: OperationalSpaceControllerActionCfg, env: TermEnv) -> BoundAsset | None:
        if cfg.task_frame is None:
            return None
        return _instance_of(BoundAsset, env.scene[cfg.task_frame], "task_frame", cfg.task_frame)

    @staticmethod
    def _find_sensor(cfg: OperationalSpaceControllerActionCfg, env: TermEnv) -> tuple[ContactSensor | None, int]:
        if cfg.contact_sensor is None:
            return None, 0
        sensor = _instance_of(ContactSensor, env.scene[cfg.contact_sensor], "contact_sensor", cfg.contact_sensor)
        return sensor, sensor.find_bodies(cfg.body_name)[0][0]

    def _scale_and_bounds(self) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        """Factor on each number of the command, and its bounds, which gains alone have."""
        cfg, control = self.cfg, self.cfg.controller_cfg
        factors = {
            "pose_abs": [cfg.position_scale] * 3 + [cfg.orientation_scale] * 4,
            "pose_rel": [cfg.position_scale] * 3 + [cfg.orientation_scale] * 3,
            "wrench_abs": [cfg.wrench_scale] * 6,
        }
        scale = [factor for kind in control.target_types for factor in factors[kind]]
        low, high = [-torch.inf] * len(scale), [torch.inf] * len(scale)
        gains = (
            (cfg.stiffness_scale, control.motion_stiffness_limits_task),
            (cfg.damping_ratio_scale, control.motion_damping_ratio_limits_task),
        )
        for factor, limits in gains[: {"fixed": 0, "variable_kp": 1, "variable": 2}[control.impedance_mode]]:
            scale += [factor] * 6
            low, high = low + [float(limits[0])] * 6, high + [float(limits[1])] * 6
        vectors = [torch.tensor(numbers, dtype=torch.float32, device=self.device) for numbers in (scale, low, high)]
        return vectors[0], (vectors[1], vectors[2])

    # ---- the command

    def _command(self, pose: torch.Tensor) -> torch.Tensor:
        """The processed actions with unit quaternions (x, y, z, w)."""
        command = self._processed_actions.clone()
        kinds = list(self.cfg.controller_cfg.target_types)
        if "pose_abs" in kinds:
            first = sum(self._controller.target_list[: kinds.index("pose_abs")]) + 3
            quat = command[:, first : first + 4]
            length = quat.norm(dim=-1, keepdim=True)
            unit = (quat.roll(-1, dims=-1) if self.cfg.scalar_first else quat) / length.clamp_min(_SMALLEST)
            command[:, first : first + 4] = torch.where(length > _SMALLEST, unit, self._in_task(pose)[:, 3:])
        return command

    def _in_task(self, pose: torch.Tensor) -> torch.Tensor:
        task = self._task_pose()
        return pose if task is None else _relative(task, pose)

    def _task_pose(self) -> torch.Tensor | None:
        """Pose of the task's frame in the root's, ``(num_envs, 7)``; None for the root's frame."""
        if self._task is None:
            return None
        return _relative(self._robot.native_data.root_pose_w, self._task.native_data.root_pose_w)

    # ---- the state

    def _frame_w(self) -> torch.Tensor:
        """Pose of the frame on the body in the world, ``(num_envs, 7)``."""
        body = self._robot.native_data.body_pose_w[:, self._body]
        pose = combine_frame_transforms(body[:, :3], body[:, 3:], self._offset_pos, self._offset_quat)
        return torch.cat(pose, dim=-1)

    def _pose(self) -> torch.Tensor:
        """Pose of the frame on the body in the root's frame, ``(num_envs, 7)``."""
        return _relative(self._robot.native_data.root_pose_w, self._frame_w())

    def _motion(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Jacobian ``(num_envs, 6, columns)`` and velocity ``(num_envs, 6)`` of the origin, in the root's frame."""
        data = self._robot.native_data
        root, velocity = data.root_pose_w, data.body_com_vel_w[:, self._body]
        origin = self._frame_w()[:, :3]
        arm = (origin - data.body_com_pose_w[:, self._body, :3]).unsqueeze(-1)
        jacobian = self._robot.dynamics.jacobians()[:, self._body]
        linear = jacobian[:, :3] + torch.linalg.cross(jacobian[:, 3:], arm.expand(-1, -1, jacobian.shape[2]), dim=1)
        to_root = matrix_from_quat(root[:, 3:]).mT
        turned = torch.cat((to_root @ linear, to_root @ jacobian[:, 3:]), dim=1)

        speed = velocity[:, :3] + torch.linalg.cross(velocity[:, 3:], arm.squeeze(-1))
        own = data.root_link_vel_w
        speed = speed - own[:, :3] - torch.linalg.cross(own[:, 3:], origin - root[:, :3])
        relative = (quat_apply_inverse(root[:, 3:], part) for part in (speed, velocity[:, 3:] - own[:, 3:]))
        return turned, torch.cat(tuple(relative), dim=-1)

    def _force(self) -> torch.Tensor | None:
        """Contact force on the body in the root's frame, ``(num_envs, 3)``."""
        if self._sensor is None:
            return None
        force = self._sensor.data.net_forces_w[:, self._sensor_body]
        return quat_apply_inverse(self._robot.native_data.root_pose_w[:, 3:], force)

    def _wanted_joints(self) -> torch.Tensor | None:
        """Joint positions that the null space is for, ``(num_envs, num_joints)``; None for zero."""
        data = self._robot.native_data
        if self.cfg.nullspace_joint_pos_target == "center":
            return data.soft_joint_pos_limits[:, self._joint_ids].mean(dim=-1)
        if self.cfg.nullspace_joint_pos_target == "default":
            return data.default_joint_pos[:, self._joint_ids]
        return None


@configclass
class OperationalSpaceControllerActionCfg(ActionTermCfg):
    """Config of :class:`OperationalSpaceControllerAction`. The joints need drives without stiffness and damping."""

    OffsetCfg: ClassVar[type] = DifferentialInverseKinematicsActionCfg.OffsetCfg
    scalar_first: ClassVar[bool] = False
    """Whether quaternions among the actions are (w, x, y, z)."""
    class_type: type | None = OperationalSpaceControllerAction
    body_name: str = MISSING
    """Body that moves or presses."""
    body_offset: DifferentialInverseKinematicsActionCfg.OffsetCfg | None = None
    """Frame on the body that is controlled; None for the frame of the body."""
    task_frame: str | None = None
    """Asset whose root frame is the task's frame; None for the frame of the robot's root."""
    contact_sensor: str | None = None
    """Contact sensor that measures the force on the body, for feedback of forces. It is up to date at each physics
    step if its ``substeps`` is True."""
    controller_cfg: OperationalSpaceControllerCfg = MISSING
    """Targets, gains and what is compensated."""
    position_scale: float = 1.0
    """Factor on positions."""
    orientation_scale: float = 1.0
    """Factor on rotation vectors; on quaternions it is without effect."""
    wrench_scale: float = 1.0
    """Factor on wrenches."""
    stiffness_scale: float = 1.0
    """Factor on stiffnesses."""
    damping_ratio_scale: float = 1.0
    """Factor on damping ratios."""
    nullspace_joint_pos_target: str = "none"
    """Joint positions that the null space control is for: ``"zero"``, ``"default"``, ``"center"`` of the soft limits,
    or ``"none"`` where nothing is controlled."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from ActionTermCfg.problems(self)
        targets = ("none", "zero", "default", "center")
        if self.nullspace_joint_pos_target not in targets:
            yield "nullspace_joint_pos_target", f"is {self.nullspace_joint_pos_target!r}, must be one of {targets}"
        if self.controller_cfg is MISSING:
            return
        control = self.controller_cfg.nullspace_control
        if (control == "none") != (self.nullspace_joint_pos_target == "none"):
            target = f"is {self.nullspace_joint_pos_target!r}"
            yield "nullspace_joint_pos_target", f"{target} with nullspace_control {control!r}; both or none are 'none'"
        if self.controller_cfg.contact_wrench_stiffness_task is not None and self.contact_sensor is None:
            yield "contact_sensor", "is missing, and contact_wrench_stiffness_task feeds measured forces back"


def _instance_of(kind: type[Found], found: object, field: str, name: str) -> Found:
    if not isinstance(found, kind):
        raise ValueError(f"{field}: '{name}' is a {type(found).__name__}, must be a {kind.__name__}")
    return found


def _relative(frame: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
    """``pose`` in ``frame``, both ``(num_envs, 7)``."""
    return torch.cat(subtract_frame_transforms(frame[:, :3], frame[:, 3:], pose[:, :3], pose[:, 3:]), dim=-1)
