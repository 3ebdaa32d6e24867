# SPDX-License-Identifier: Apache-2.0
"""Manager-based reach: an arm brings its flange to a commanded pose: ``Stripe-Reach-v0``.

Observations, rewards, curriculum and their numbers are those of Isaac Lab's ``Isaac-Reach-UR10-v0``. The arm is that
of :mod:`stripe_tasks.reach.arm`.
"""

from __future__ import annotations

import math

import warp as wp

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.goal_marker import GoalMarked, goal_marker
from stripe_tasks.robot_scene import RobotSceneCfg

from .arm import ARM_CFG

__all__ = [
    "ActionsCfg",
    "CommandsCfg",
    "CurriculumCfg",
    "EventsCfg",
    "ObservationsCfg",
    "ReachEnv",
    "ReachEnvCfg",
    "ReachPPORunnerCfg",
    "ReachSceneCfg",
    "RewardsCfg",
    "TerminationsCfg",
]

FLANGE = "wrist_3_link"
TRACKED = {"asset_cfg": SceneEntityCfg("robot", body_names=FLANGE), "command_name": "ee_pose"}
NOISE = UniformNoiseCfg(n_min=-0.01, n_max=0.01)


@configclass
class ReachSceneCfg(RobotSceneCfg):
    """Scene with the arm on the ground, and a frame that marks the commanded pose."""

    goal: RigidObjectCfg = goal_marker("frame", 0.1)


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The joints, the commanded pose, the last actions."""

        joint_pos: ObservationTermCfg | None = ObservationTermCfg(func=mdp.joint_pos_rel, noise=NOISE)
        joint_vel: ObservationTermCfg | None = ObservationTermCfg(func=mdp.joint_vel_rel, noise=NOISE)
        pose_command: ObservationTermCfg = ObservationTermCfg(
            func=mdp.generated_commands, params={"command_name": "ee_pose"}
        )
        actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)

    policy: PolicyCfg = PolicyCfg(enable_corruption=True)


@configclass
class ActionsCfg:
    """Actions: positions of all joints, relative to the default pose."""

    arm_action: mdp.ActionTermCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=[".*"], scale=0.5, use_default_offset=True
    )


@configclass
class CommandsCfg:
    """Command: a pose of the flange in front of the arm, facing down, a new one every 4 s."""

    ee_pose: mdp.UniformPoseCommandCfg = mdp.UniformPoseCommandCfg(
        asset_name="robot",
        body_name=FLANGE,
        resampling_time_range=(4.0, 4.0),
        ranges=mdp.UniformPoseCommandCfg.Ranges(
            pos_x=(0.3, 0.55),
            pos_y=(-0.25, 0.25),
            pos_z=(0.1, 0.4),
            roll=(-0.5 * math.pi, -0.5 * math.pi),  # the flange faces its own y
            pitch=(0.0, 0.0),
            yaw=(-math.pi, math.pi),
        ),
    )


@configclass
class RewardsCfg:
    """Rewards for being near the commanded pose, less jerky actions and fast joints."""

    end_effector_position_tracking: RewardTermCfg = RewardTermCfg(
        func=mdp.position_command_error, weight=-0.2, params=TRACKED
    )
    end_effector_position_tracking_fine_grained: RewardTermCfg = RewardTermCfg(
        func=mdp.position_command_error_tanh, weight=0.1, params={**TRACKED, "std": 0.1}
    )
    end_effector_orientation_tracking: RewardTermCfg = RewardTermCfg(
        func=mdp.orientation_command_error, weight=-0.1, params=TRACKED
    )
    action_rate: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.0001)
    joint_vel: RewardTermCfg = RewardTermCfg(func=mdp.joint_vel_l2, weight=-0.0001)


@configclass
class TerminationsCfg:
    """An episode ends after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)


@configclass
class EventsCfg:
    """An episode starts near the default pose."""

    reset_robot_joints: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_scale,
        mode="reset",
        params={"position_range": (0.8, 1.2), "velocity_range": (0.0, 0.0)},
    )


@configclass
class CurriculumCfg:
    """Curriculum: smooth motion counts more after 4500 steps, when the arm reaches its poses."""

    action_rate: CurriculumTermCfg = CurriculumTermCfg(
        func=mdp.modify_reward_weight, params={"term_name": "action_rate", "weight": -0.005, "num_steps": 4500}
    )
    joint_vel: CurriculumTermCfg = CurriculumTermCfg(
        func=mdp.modify_reward_weight, params={"term_name": "joint_vel", "weight": -0.001, "num_steps": 4500}
    )


@configclass
class ReachEnvCfg(ManagerBasedRLEnvCfg):
    """Reach with an arm: 25 observations, 6 joint positions, episodes of 12 s with three poses."""

    decimation: int = 2
    episode_length_s: float = 12.0
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 60.0,
        render_interval=2,
        solver=MuJoCoSolverCfg(
            disable_contacts=True
        ),  # between these poses the arm touches neither itself nor the ground
    )
    scene: ReachSceneCfg = ReachSceneCfg(
        num_envs=4096, env_spacing=2.5, robot=ARM_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    )
    viewer: ViewerCfg = ViewerCfg(eye=(1.25, 1.0, 0.75), lookat=(0.18, 0.0, 0.27))
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()


class ReachEnv(GoalMarked, ManagerBasedRLEnv):
    """Reach: a manager-based environment that shows the commanded pose."""

    cfg: ReachEnvCfg

    def _goals(self) -> tuple[wp.array, wp.array]:
        commands = wp.from_torch(self.command_manager.get_command("ee_pose"), dtype=wp.transform)
        return self.scene["robot"].data.struct.root_pose, commands


@configclass
class ReachPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for reaching."""

    num_steps_per_env: int = 24
    max_iterations: int = 500
    save_interval: int = 50
    experiment_name: str = "reach"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(64, 64),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(64, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(num_learning_epochs=8, entropy_coef=0.001)
