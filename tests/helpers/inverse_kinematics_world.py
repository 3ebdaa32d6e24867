# SPDX-License-Identifier: Apache-2.0
"""Robots in random states for inverse kinematics, with the model that MuJoCo makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import ActionManager, ManagerContext
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_tasks.reach.arm import ARM_CFG
from tests.helpers.manager_world import plan
from tests.helpers.small_scenes import numpy

ARM = ARM_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
"""The arm of the reach task."""
FLANGE = "wrist_3_link"
Action, Controller = mdp.DifferentialInverseKinematicsActionCfg, mdp.DifferentialIKControllerCfg
OFFSET = Action.OffsetCfg(pos=(0.05, -0.02, 0.11), rot=tuple(Rotation.from_rotvec([0.3, -1.0, 0.4]).as_quat().tolist()))
NONE = Action.OffsetCfg()
"""No offset: the frame of the body."""

TROLLEY = """<mujoco><compiler angle="radian"/><worldbody>
<body name="trolley" pos="0.1 0.2 0.3" euler="0.3 -0.2 0.5"><joint name="drive" type="slide" axis="1 0 0"/>
<joint name="lift" type="slide" axis="0 0 1"/><joint name="turn" axis="0 1 0" pos="0.1 0 0.2"/>
<inertial pos="0 0.05 0.1" mass="3" diaginertia=".05 .06 .07"/>
<body name="ball" pos="0.2 0 0.1" euler="-0.4 0.1 0.7"><joint name="roll" axis="1 0 0" pos="0.03 0.01 -0.02"/>
<joint name="pitch" axis="0 1 0" pos="0.03 0.01 -0.02"/><joint name="yaw" axis="0 0 1" pos="0.03 0.01 -0.02"/>
<inertial pos="0.1 0.03 -0.2" mass="1" diaginertia=".01 .012 .013"/>
<body name="rod" pos="0.1 0 -0.4" euler="0 1 0.2"><joint name="reach" type="slide" axis="0 0.6 0.8"/>
<inertial pos="0 0 -0.15" mass="0.5" diaginertia=".004 .005 .003"/></body></body>
<body name="side" pos="0 -0.3 0"><joint name="aside" axis="1 0 0"/>
<inertial pos="0 0 -0.15" mass="0.5" diaginertia=".004 .005 .003"/></body></body></worldbody></mujoco>"""
"""Joints with several axes, the first of which hangs on the world, and a branch aside."""


def action(
    body: str = FLANGE, command: str = "pose", method: str = "dls", relative: bool = False, **fields: Any
) -> Any:
    """The config of an action on all joints."""
    params = fields.pop("ik_params", None)
    controller = Controller(command_type=command, use_relative_mode=relative, ik_method=method, ik_params=params)
    return Action(
        **{"asset_name": "robot", "joint_names": [".*"], "body_name": body, "controller": controller, **fields}
    )


class World:
    """An action manager on a robot in a random state.

    Attributes:
        model: MuJoCo's model of one environment, from the file that the solver saved.
    """

    def __init__(self, robot: Any, term: Any, folder: Path, num_envs: int = 4, seed: int = 3):
        path = folder / "robot.xml"
        solver = MuJoCoSolverCfg(disable_contacts=True, save_to_mjcf=str(path))
        scene = InteractiveScene(
            InteractiveSceneCfg(num_envs=num_envs, env_spacing=4.0),
            Simulation(SimulationCfg(device="cpu", dt=1.0 / 120.0, solver=solver)),
        )
        with scene.construction():
            scene.builder.build_robot("robot", robot)
        scene.clone_environments()
        scene.build()
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.context = context = ManagerContext(scene, 1.0 / 60.0, 2, 1.0, 60)
        self.scene, self.robot, self.num_envs = scene, scene["robot"], num_envs
        self.rng = np.random.default_rng(seed)
        self.manager = ActionManager({"arm": term}, context)
        self.problems = context.problems
        if not self.problems:
            self._process, self._apply = (
                plan(context, items()) for items in (self.manager.process_items, self.manager.apply_items)
            )

    def put(self, joints: np.ndarray, turn_root: bool = False) -> None:
        """Joint positions, shape ``(num_envs, num_joints)``; and the root somewhere in its environment."""
        ids, robot = torch.arange(self.num_envs), self.robot
        robot.write_joint_state_to_sim(torch.tensor(joints, dtype=torch.float32), torch.zeros(joints.shape))
        if turn_root:
            pose = robot.data.default_root_state[:, :7].clone()
            pose[:, :3] += self.scene.env_origins + torch.tensor(self.rng.normal(size=(self.num_envs, 3)))
            turn = torch.tensor(self.rng.normal(size=(self.num_envs, 4)))
            pose[:, 3:] = turn / turn.norm(dim=-1, keepdim=True)
            robot.write_root_pose_to_sim(pose, ids)
        self.scene.sim.forward()

    def scatter(self, spread: float = 1.0, turn_root: bool = False) -> None:
        """A random state."""
        self.put(self.rng.uniform(-spread, spread, size=(self.num_envs, self.robot.num_joints)), turn_root)

    def process(self, action: Any) -> np.ndarray:
        """The desired poses for these actions."""
        self.context.torch(self.manager.input)[:] = torch.as_tensor(action, dtype=torch.float32)
        self._process.run()
        return self.desired

    @property
    def desired(self) -> np.ndarray:
        """Desired poses in the root's frame, shape ``(num_envs, 7)``."""
        found: np.ndarray = self.context.arrays["actions.arm.processed"].numpy()
        return found

    @desired.setter
    def desired(self, poses: np.ndarray) -> None:
        self.context.arrays["actions.arm.processed"].assign(poses.astype(np.float32))

    def steps(self) -> np.ndarray:
        """Differences of targets and positions, float64."""
        self._apply.run()
        data = self.robot.data
        return numpy(data.joint_pos_target).astype(float) - numpy(data.joint_pos).astype(float)

    def mujoco(self, env: int, body: int, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of a point of a body in the root's environment: its position in the world, the body's rotation matrix, and
        the Jacobian (linear, angular) by the asset's joints, shape ``(6, num_joints)``."""
        model, data = self.model, mujoco.MjData(self.model)
        free = model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
        first = (7, 6) if free else (0, 0)
        if free:
            pose = numpy(self.robot.data.root_state_w[env, :7])
            data.qpos[:3], data.qpos[3:7] = pose[:3], pose[[6, 3, 4, 5]]
        data.qpos[first[0] :] = numpy(self.robot.data.joint_pos[env])
        mujoco.mj_forward(model, data)
        index = 1 + body  # the world is the first
        matrix = data.xmat[index].reshape(3, 3)
        point = data.xpos[index] + matrix @ offset
        jacobian = np.zeros((2, 3, model.nv))
        mujoco.mj_jac(model, data, jacobian[0], jacobian[1], point, index)
        origin = np.zeros(3) if free else self.scene.env_origins[env].numpy()
        return point + origin, matrix, jacobian.reshape(6, -1)[:, first[1] :]


def frames_of(world: World | ManagerBasedRLEnv, offset: Any, body: int = -1) -> tuple[np.ndarray, Rotation]:
    """Positions and rotations of a frame of a body in the root's frame, from the body poses."""
    data = world.scene["robot"].data
    root = Rotation.from_quat(numpy(data.root_quat_w).astype(float))
    turn = Rotation.from_quat(numpy(data.body_quat_w[:, body]).astype(float))
    pos = numpy(data.body_pos_w[:, body]).astype(float) + turn.apply(offset.pos) - numpy(data.root_pos_w)
    return root.inv().apply(pos), root.inv() * turn * Rotation.from_quat(offset.rot)
