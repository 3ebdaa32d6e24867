# SPDX-License-Identifier: Apache-2.0
"""Open a drawer with the Panda: ``Stripe-Open-Cabinet-Panda-v0``.

Observations, rewards and their numbers are those of Isaac Lab's ``Isaac-Open-Drawer-Franka-v0``. The cabinet is that of
:mod:`stripe_tasks.manipulation.cabinet_model`.
"""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.published_robots import soft_panda_cfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.success import SuccessManagerCfg

from . import terms
from .cabinet_model import CABINET_CFG, HANDLE
from .lift import FINGERS
from .reach import ARM, FINGERTIPS, HAND

__all__ = ["CabinetEnvCfg", "CabinetPPORunnerCfg"]

DRAWER = "drawer_top"
TIP = (0.0, 0.0, 0.046)
"""Tip of a finger in the frame of the finger [m]."""
OPEN = 0.04
"""Position of each finger's joint where the gripper is open [m]."""
_DRAWER = SceneEntityCfg("cabinet", body_names=DRAWER)
_JOINT = SceneEntityCfg("cabinet", joint_names=f"{DRAWER}_joint")
_HAND = {
    "robot_cfg": SceneEntityCfg("robot", body_names=HAND),
    "cabinet_cfg": _DRAWER,
    "point": FINGERTIPS,
    "handle": HANDLE,
}
_TIPS = {
    "robot_cfg": SceneEntityCfg("robot"),
    "cabinet_cfg": _DRAWER,
    "finger_cfg": SceneEntityCfg("robot", body_names="(left|right)_finger"),
    "tip": TIP,
    "handle": HANDLE,
}
_OPENED = {**_TIPS, "drawer_cfg": _JOINT}


@configclass
class CabinetSceneCfg(RobotSceneCfg):
    """Scene with the arm and the cabinet in front of it."""

    cabinet: ArticulationCfg = CABINET_CFG


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The joints of the arm and of the drawer, the way to the handle, the last actions."""

        joint_pos: ObservationTermCfg = ObservationTermCfg(
            func=mdp.joint_pos_rel, params={"asset_cfg": SceneEntityCfg("robot")}
        )
        joint_vel: ObservationTermCfg = ObservationTermCfg(
            func=mdp.joint_vel_rel, params={"asset_cfg": SceneEntityCfg("robot")}
        )
        cabinet_joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel, params={"asset_cfg": _JOINT})
        cabinet_joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel, params={"asset_cfg": _JOINT})
        rel_ee_drawer_distance: ObservationTermCfg = ObservationTermCfg(func=terms.rel_ee_drawer_distance, params=_HAND)
        actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)

    policy: PolicyCfg = PolicyCfg()


@configclass
class ActionsCfg:
    """Actions: positions of the arm's joints, relative to the default pose; fingers open or closed."""

    arm_action: mdp.ActionTermCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=ARM, scale=1.0, use_default_offset=True
    )
    gripper_action: mdp.BinaryJointPositionActionCfg = mdp.BinaryJointPositionActionCfg(
        asset_name="robot",
        joint_names=FINGERS,
        open_command_expr={"finger_joint.*": OPEN},
        close_command_expr={"finger_joint.*": 0.0},
    )


@configclass
class EventsCfg:
    """Friction differs; an episode starts near the default pose, with the drawers closed."""

    robot_physics_material: EventTermCfg = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", body_names="(left|right)_finger"),
            "static_friction_range": (0.8, 1.25),
        },
    )
    cabinet_physics_material: EventTermCfg = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={"asset_cfg": _DRAWER, "static_friction_range": (1.0, 1.25)},
    )
    reset_all: EventTermCfg = EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")
    reset_robot_joints: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_offset,
        mode="reset",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=ARM),
            "position_range": (-0.1, 0.1),
            "velocity_range": (0.0, 0.0),
        },
    )


@configclass
class RewardsCfg:
    """Rewards for reaching the handle, grasping it and opening the drawer, less jerky actions and fast joints."""

    approach_ee_handle: RewardTermCfg = RewardTermCfg(
        func=terms.approach_ee_handle, weight=2.0, params={**_HAND, "threshold": 0.2}
    )
    align_ee_handle: RewardTermCfg = RewardTermCfg(
        func=terms.align_ee_handle,
        weight=0.5,
        params={"robot_cfg": SceneEntityCfg("robot", body_names=HAND), "cabinet_cfg": _DRAWER},
    )
    approach_gripper_handle: RewardTermCfg = RewardTermCfg(
        func=terms.approach_gripper_handle, weight=5.0, params={**_TIPS, "offset": OPEN}
    )
    align_grasp_around_handle: RewardTermCfg = RewardTermCfg(
        func=terms.align_grasp_around_handle, weight=0.125, params=_TIPS
    )
    grasp_handle: RewardTermCfg = RewardTermCfg(
        func=terms.grasp_handle,
        weight=0.5,
        params={
            **_HAND,
            "finger_cfg": SceneEntityCfg("robot", joint_names=FINGERS),
            "threshold": 0.03,
            "open_joint_pos": OPEN,
        },
    )
    open_drawer_bonus: RewardTermCfg = RewardTermCfg(func=terms.open_drawer_bonus, weight=7.5, params=_OPENED)
    multi_stage_open_drawer: RewardTermCfg = RewardTermCfg(
        func=terms.multi_stage_open_drawer, weight=1.0, params=_OPENED
    )
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.01)
    joint_vel: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_vel_l2, weight=-0.0001, params={"asset_cfg": SceneEntityCfg("robot")}
    )


@configclass
class TerminationsCfg:
    """An episode ends after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)


@configclass
class CabinetEnvCfg(ManagerBasedRLEnvCfg):
    """Open a drawer with the Panda: 31 observations, 7 joint positions and the gripper, episodes of 8 s.

    An episode is a success where the drawer is open by 30 cm at the end.
    """

    decimation: int = 2
    episode_length_s: float = 8.0
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 120.0,
        render_interval=2,
        solver=MuJoCoSolverCfg(iterations=20, ls_iterations=20, nconmax=160, njmax=640, cone="elliptic", impratio=10.0),
    )
    scene: CabinetSceneCfg = CabinetSceneCfg(num_envs=4096, env_spacing=2.5)
    viewer: ViewerCfg = ViewerCfg(eye=(-1.0, 1.7, 1.3), lookat=(0.5, 0.0, 0.4))
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    managers = {
        "success": SuccessManagerCfg(func=terms.drawer_is_open, params={"cabinet_cfg": _JOINT, "threshold": 0.3})
    }

    def __post_init__(self) -> None:
        self.scene.robot = soft_panda_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")
        # Stronger than for light things, but not so strong that the light fingers are pressed through the handle.
        fingers = self.scene.robot.actuators["fingers"]
        fingers.stiffness, fingers.damping, fingers.effort_limit = 600.0, 60.0, 20.0


@configclass
class CabinetPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for opening a drawer."""

    num_steps_per_env: int = 96
    max_iterations: int = 400
    save_interval: int = 50
    experiment_name: str = "open_cabinet_panda"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(256, 128, 64),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(256, 128, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.001, learning_rate=5.0e-4, desired_kl=0.02)
