# SPDX-License-Identifier: Apache-2.0
"""Scripted Panda: joint targets for paths of its fingertips, by inverse kinematics of MuJoCo's own model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.spatial.transform import Rotation

POINT = np.array([0.0, 0.0, 0.1034])
"""Point between the fingertips in the frame of the hand [m]."""
DOWN = np.diag([1.0, -1.0, -1.0])
"""Orientation of a hand that points down."""


class PandaArm:
    """Path of the point between the fingertips, followed by all environments of a task with joint position actions.

    Targets of the soft arm include what gravity takes from it.
    """

    def __init__(self, env: Any, file: Path, scale: float, stiffness: float):
        """Start where the arm is; ``scale`` [rad] is that of the actions, ``stiffness`` [N m/rad] that of the arm."""
        self.env, self._scale, self._stiffness = env, scale, stiffness
        self.robot = env.scene["robot"]
        self._model = mujoco.MjModel.from_xml_path(str(file))
        self._data, self._hand = mujoco.MjData(self._model), self._model.body("hand").id
        self._default = self.robot.data.default_joint_pos[:, :7].numpy().astype(float)
        self._joints = self._default.copy()
        self.tip, self.rotation = self._pose(self._joints[0])
        self.tip = np.repeat(self.tip[None], env.num_envs, axis=0)
        self.total = np.zeros(env.num_envs)

    def _pose(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self._data.qpos[:7] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        rotation = self._data.xmat[self._hand].reshape(3, 3).copy()
        return self._data.xpos[self._hand] + rotation @ POINT, rotation

    def _solve(self, joints: np.ndarray, tip: np.ndarray) -> np.ndarray:
        """Joints that put the fingertips at a point with the present orientation: a few damped Newton steps."""
        jacobian, limits = np.zeros((6, self._model.nv)), self._model.jnt_range[:7].T
        for _ in range(8):
            at, rotation = self._pose(joints)
            turn = Rotation.from_matrix(self.rotation @ rotation.T).as_rotvec()
            mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], at, self._hand)
            arm, error = jacobian[:, :7], np.concatenate((tip - at, turn))
            change = arm.T @ np.linalg.solve(arm @ arm.T + 1e-4 * np.eye(6), error)
            joints = np.clip(joints + np.clip(change, -0.3, 0.3), *limits)
        return joints

    def _sag(self, joints: np.ndarray) -> np.ndarray:
        """How far gravity bends the soft arm [rad]."""
        self._data.qpos[:7], self._data.qpos[7:], self._data.qvel[:] = joints, 0.02, 0.0
        mujoco.mj_forward(self._model, self._data)
        return self._data.qfrc_bias[:7] / self._stiffness

    def step(self, gripper: float) -> None:
        """One step of the environment, with the fingers open (1) or closed (-1); adds up the rewards."""
        present = self.robot.data.joint_pos[:, :7].numpy().astype(float)
        self._joints = np.array([self._solve(q, tip) for q, tip in zip(self._joints, self.tip, strict=True)])
        targets = self._joints + np.array([self._sag(q) for q in present])
        actions = np.concatenate(((targets - self._default) / self._scale, np.full((len(targets), 1), gripper)), axis=1)
        _, reward, *_ = self.env.step(torch.as_tensor(actions, dtype=torch.float32))
        self.total += reward.numpy()

    def move(self, goal: np.ndarray, speed: float, gripper: float, pause: int = 10) -> None:
        """Move the fingertips in straight lines to points, shape (num_envs, 3) [m], at a speed [m/s], and wait."""
        length = speed * self.env.step_dt
        while (left := np.linalg.norm(goal - self.tip, axis=1)).max() > 1e-4:
            self.tip += (goal - self.tip) * np.minimum(1.0, length / np.maximum(left, 1e-9))[:, None]
            self.step(gripper)
        for _ in range(pause):
            self.step(gripper)

    def turn(self, rotation: np.ndarray, steps: int) -> None:
        """Turn the hand by even steps, with the fingers open."""
        start = Rotation.from_matrix(self.rotation)
        way = (Rotation.from_matrix(rotation) * start.inv()).as_rotvec()
        for k in range(1, steps + 1):
            self.rotation = (Rotation.from_rotvec(way * k / steps) * start).as_matrix()
            self.step(1.0)
