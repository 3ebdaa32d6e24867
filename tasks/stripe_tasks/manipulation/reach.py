# SPDX-License-Identifier: Apache-2.0
"""Reach by the Panda: ``Stripe-Reach-Panda-v0`` and the same with other actions.

``...-Panda-v0`` has positions of the joints as actions, ``...-Panda-IK-Rel-v0`` shifts and turns of the hand by inverse
kinematics, ``...-Panda-OSC-v0`` poses and stiffness of the hand by operational space control. Commands, rewards and
numbers are those of Isaac Lab's ``Isaac-Reach-Franka-v0`` and its variants, but for the scale of shifts and turns.
"""

from __future__ import annotations

import math

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.configclass import configclass
from stripe_newton.controllers import OperationalSpaceControllerCfg
from stripe_newton.envs import mdp
from stripe_newton.managers import SceneEntityCfg
from stripe_tasks.published_robots import panda_cfg
from stripe_tasks.reach import ActionsCfg, ReachEnv, ReachEnvCfg, ReachPPORunnerCfg, ReachSceneCfg
from stripe_tasks.success import SuccessEnv, SuccessManagerCfg

from . import terms

__all__ = [
    "PandaReachEnv",
    "PandaReachEnvCfg",
    "PandaReachIKEnvCfg",
    "PandaReachOSCEnvCfg",
    "PandaReachOSCPPORunnerCfg",
    "PandaReachPPORunnerCfg",
]

ARM = ["joint[1-7]"]
HAND = "hand"
FINGERTIPS = (0.0, 0.0, 0.1034)
"""Point between the fingertips in the frame of the hand [m]."""
_Ik = mdp.DifferentialInverseKinematicsActionCfg


@configclass
class PandaReachEnvCfg(ReachEnvCfg):
    """Reach with the Panda: joint positions relative to the default pose.

    An episode is a success where the hand is within 2 cm and 0.2 rad of the commanded pose at its end, 4 s after that
    was drawn. The metrics of the command are means over time, with the ways from pose to pose.
    """

    scene: ReachSceneCfg = ReachSceneCfg(num_envs=4096, env_spacing=2.5)
    managers = {
        "success": SuccessManagerCfg(
            func=terms.hand_at_pose,
            params={
                "asset_cfg": SceneEntityCfg("robot", body_names=HAND),
                "command_name": "ee_pose",
                "distance": 0.02,
                "angle": 0.2,
            },
        )
    }

    def __post_init__(self) -> None:
        self.scene.robot = panda_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")
        for term in (
            self.rewards.end_effector_position_tracking,
            self.rewards.end_effector_position_tracking_fine_grained,
            self.rewards.end_effector_orientation_tracking,
        ):
            term.params["asset_cfg"] = SceneEntityCfg("robot", body_names=HAND)
        command = self.commands.ee_pose
        command.body_name = HAND
        ranges = command.ranges
        ranges.pos_x, ranges.pos_y, ranges.pos_z = (0.35, 0.65), (-0.2, 0.2), (0.15, 0.5)
        ranges.roll, ranges.pitch = (0.0, 0.0), (math.pi, math.pi)
        self.actions.arm_action.joint_names = ARM
        self.events.reset_robot_joints.params["position_range"] = (0.5, 1.5)
        self.viewer.eye, self.viewer.lookat = (1.7, 1.4, 1.0), (0.3, 0.0, 0.3)


class PandaReachEnv(ReachEnv, SuccessEnv):
    """Reach: a manager-based environment that shows the commanded pose and tells whether it is reached."""

    cfg: PandaReachEnvCfg


@configclass
class IKActionsCfg(ActionsCfg):
    """Actions: shifts and turns of the point between the fingertips, relative to its present pose."""

    arm_action: _Ik = _Ik(
        asset_name="robot",
        joint_names=ARM,
        body_name=HAND,
        body_offset=_Ik.OffsetCfg(pos=FINGERTIPS),
        controller=mdp.DifferentialIKControllerCfg(command_type="pose", use_relative_mode=True, ik_method="dls"),
        # Isaac Lab's 0.5 is for teleoperation. Random actions of that size carry the hand into the arm's base.
        scale=0.05,
    )


@configclass
class PandaReachIKEnvCfg(PandaReachEnvCfg):
    """Reach with the Panda: shifts and turns of the hand, by inverse kinematics."""

    actions: IKActionsCfg = IKActionsCfg()


@configclass
class OSCActionsCfg(ActionsCfg):
    """Actions: pose of the hand in the frame of the base, and stiffness along and about each axis."""

    arm_action: mdp.OperationalSpaceControllerActionCfg = mdp.OperationalSpaceControllerActionCfg(
        asset_name="robot",
        joint_names=ARM,
        body_name=HAND,
        controller_cfg=OperationalSpaceControllerCfg(
            target_types=["pose_abs"],
            impedance_mode="variable_kp",
            inertial_dynamics_decoupling=True,
            partial_inertial_dynamics_decoupling=False,
            gravity_compensation=True,
            motion_stiffness_task=100.0,
            motion_damping_ratio_task=1.0,
            motion_stiffness_limits_task=(50.0, 200.0),
            nullspace_control="position",
        ),
        nullspace_joint_pos_target="center",
        position_scale=1.0,
        orientation_scale=1.0,
        stiffness_scale=100.0,
    )


@configclass
class PandaReachOSCEnvCfg(PandaReachEnvCfg):
    """Reach with the Panda: poses and stiffness of the hand, by operational space control."""

    actions: OSCActionsCfg = OSCActionsCfg()

    def __post_init__(self) -> None:
        super().__post_init__()
        # The controller gives torques: the drives must not hold the joints as well.
        self.scene.robot.actuators["arm"] = ImplicitActuatorCfg(
            joint_names_expr=ARM,
            stiffness=0.0,
            damping=0.0,
            effort_limit={"joint[1-4]": 87.0, "joint[567]": 12.0},
            velocity_limit={"joint[1-4]": 2.175, "joint[567]": 2.61},
        )
        # Positions of the joints are of no use to a policy that commands poses of the hand.
        self.observations.policy.joint_pos = self.observations.policy.joint_vel = None


@configclass
class PandaReachPPORunnerCfg(ReachPPORunnerCfg):
    """PPO for reaching with the Panda."""

    max_iterations: int = 1000
    experiment_name: str = "reach_panda"


@configclass
class PandaReachOSCPPORunnerCfg(PandaReachPPORunnerCfg):
    """PPO for reaching with the Panda by operational space control."""

    experiment_name: str = "reach_panda_osc"
