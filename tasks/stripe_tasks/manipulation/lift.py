# SPDX-License-Identifier: Apache-2.0
"""Lift by the Panda: it takes a cube and carries it to a commanded place: ``Stripe-Lift-Cube-Panda-v0``.

Observations, rewards, curriculum and their numbers are those of Isaac Lab's ``Isaac-Lift-Cube-Franka-v0``, but a cube
counts as lifted only while it is between the fingers: a cube that was thrown up would earn two fifths of one that is
held, within the horizon of the discount, and throwing is easier to find. The cube lies on the ground that the arm
stands on, theirs on a table as high as the arm's base.
"""

from __future__ import annotations

import warp as wp

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    PreviewSurfaceCfg,
    RigidBodyMaterialCfg,
    RigidBodyPropertiesCfg,
    SimulationCfg,
)
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.goal_marker import GoalMarked, goal_marker
from stripe_tasks.published_robots import soft_panda_cfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.success import SuccessEnv, SuccessManagerCfg

from . import terms
from .reach import ARM, FINGERTIPS, HAND

__all__ = ["FINGERS", "LiftEnv", "LiftEnvCfg", "LiftPPORunnerCfg"]

FINGERS = ["finger_joint[12]"]
GOAL = {"command_name": "object_pose"}
SIZE = 0.048
"""Length of the cube's edges [m]."""
LIFTED = 0.04
"""Height of the cube's middle from which it counts as lifted [m]."""
CUBE = {"object_cfg": SceneEntityCfg("object")}
BOTH = {**CUBE, "robot_cfg": SceneEntityCfg("robot")}
GRIPPER = {**CUBE, "robot_cfg": SceneEntityCfg("robot", body_names=HAND), "point": FINGERTIPS}
HELD = {**GRIPPER, "reach": 0.05, "minimal_height": LIFTED}


@configclass
class LiftSceneCfg(RobotSceneCfg):
    """Scene with the arm and a cube in front of it, and a ball that marks where it is to go."""

    object: RigidObjectCfg = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Object",
        spawn=CuboidCfg(
            size=(SIZE, SIZE, SIZE),
            rigid_props=RigidBodyPropertiesCfg(),
            collision_props=CollisionPropertiesCfg(),
            mass_props=MassPropertiesCfg(mass=0.1),
            physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0),
            visual_material=PreviewSurfaceCfg(diffuse_color=(0.85, 0.2, 0.05)),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.5, 0.0, 0.5 * SIZE)),
    )
    goal: RigidObjectCfg = goal_marker("ball", 0.015, color=(0.1, 0.55, 0.2))


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The joints, the cube and where it is to go, the last actions."""

        joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel)
        joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel)
        object_position: ObservationTermCfg = ObservationTermCfg(
            func=terms.object_position_in_robot_root_frame, params=BOTH
        )
        target_object_position: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params=GOAL)
        actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)

    policy: PolicyCfg = PolicyCfg()


@configclass
class ActionsCfg:
    """Actions: positions of the arm's joints, relative to the default pose; fingers open or closed."""

    arm_action: mdp.ActionTermCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=ARM, scale=0.5, use_default_offset=True
    )
    gripper_action: mdp.BinaryJointPositionActionCfg = mdp.BinaryJointPositionActionCfg(
        asset_name="robot",
        joint_names=FINGERS,
        open_command_expr={"finger_joint.*": 0.04},
        close_command_expr={"finger_joint.*": 0.0},
    )


@configclass
class CommandsCfg:
    """Command: a place above the ground in front of the arm."""

    object_pose: mdp.UniformPoseCommandCfg = mdp.UniformPoseCommandCfg(
        asset_name="robot",
        body_name=HAND,
        resampling_time_range=(5.0, 5.0),
        ranges=mdp.UniformPoseCommandCfg.Ranges(
            pos_x=(0.4, 0.6), pos_y=(-0.25, 0.25), pos_z=(0.25, 0.5), roll=(0.0, 0.0), pitch=(0.0, 0.0), yaw=(0.0, 0.0)
        ),
    )


@configclass
class RewardsCfg:
    """Rewards for reaching the cube, lifting it and bringing it to its place, less jerky actions and fast joints."""

    reaching_object: RewardTermCfg = RewardTermCfg(
        func=terms.object_ee_distance, weight=1.0, params={**GRIPPER, "std": 0.1}
    )
    lifting_object: RewardTermCfg = RewardTermCfg(func=terms.held_object_is_lifted, weight=15.0, params=HELD)
    object_goal_tracking: RewardTermCfg = RewardTermCfg(
        func=terms.held_object_goal_distance, weight=16.0, params={**HELD, **GOAL, "std": 0.3}
    )
    object_goal_tracking_fine_grained: RewardTermCfg = RewardTermCfg(
        func=terms.held_object_goal_distance, weight=5.0, params={**HELD, **GOAL, "std": 0.05}
    )
    action_rate: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-1.0e-4)
    joint_vel: RewardTermCfg = RewardTermCfg(
        func=mdp.joint_vel_l2, weight=-1.0e-4, params={"asset_cfg": SceneEntityCfg("robot")}
    )


@configclass
class TerminationsCfg:
    """An episode ends after its full length, or when the cube is gone."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    object_dropping: TerminationTermCfg = TerminationTermCfg(
        func=mdp.root_height_below_minimum, params={"asset_cfg": SceneEntityCfg("object"), "minimum_height": -0.05}
    )


@configclass
class EventsCfg:
    """An episode starts in the default pose, with the cube anywhere in front of the arm."""

    reset_all: EventTermCfg = EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")
    reset_object_position: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform,
        mode="reset",
        params={
            "asset_cfg": SceneEntityCfg("object"),
            "pose_range": {"x": (-0.1, 0.1), "y": (-0.25, 0.25), "z": (0.0, 0.0)},
            "velocity_range": {},
        },
    )


@configclass
class CurriculumCfg:
    """Curriculum: smooth motion counts more after 10,000 steps."""

    action_rate: CurriculumTermCfg = CurriculumTermCfg(
        func=mdp.modify_reward_weight, params={"term_name": "action_rate", "weight": -0.1, "num_steps": 10000}
    )
    joint_vel: CurriculumTermCfg = CurriculumTermCfg(
        func=mdp.modify_reward_weight, params={"term_name": "joint_vel", "weight": -0.1, "num_steps": 10000}
    )


@configclass
class LiftEnvCfg(ManagerBasedRLEnvCfg):
    """Lift with the Panda: 36 observations, 7 joint positions and the gripper, episodes of 5 s.

    An episode is a success where the cube is within 5 cm of its place at the end.
    """

    decimation: int = 4
    episode_length_s: float = 5.0
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        render_interval=4,
        # With pyramids and a ratio of 1 a cube that is shaken creeps out of the gripper.
        solver=MuJoCoSolverCfg(iterations=20, ls_iterations=20, nconmax=160, njmax=640, cone="elliptic", impratio=10.0),
    )
    scene: LiftSceneCfg = LiftSceneCfg(num_envs=4096, env_spacing=2.5)
    viewer: ViewerCfg = ViewerCfg(eye=(1.5, 1.2, 0.9), lookat=(0.35, 0.0, 0.2))
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()
    managers = {"success": SuccessManagerCfg(func=terms.object_at_goal, params={**BOTH, **GOAL, "threshold": 0.05})}

    def __post_init__(self) -> None:
        self.scene.robot = soft_panda_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")


class LiftEnv(GoalMarked, SuccessEnv):
    """Lift: a manager-based environment that shows where the cube is to go."""

    cfg: LiftEnvCfg

    def _goals(self) -> tuple[wp.array, wp.array]:
        commands = wp.from_torch(self.command_manager.get_command("object_pose"), dtype=wp.transform)
        return self.scene["robot"].data.struct.root_pose, commands


@configclass
class LiftPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for lifting."""

    num_steps_per_env: int = 24
    max_iterations: int = 1500
    save_interval: int = 100
    experiment_name: str = "lift_cube_panda"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(256, 128, 64),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(256, 128, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.006, learning_rate=1.0e-4, gamma=0.98)
