# SPDX-License-Identifier: Apache-2.0
"""Manager-based locomotion: ``Stripe-Ant-v0`` and ``Stripe-Humanoid-v0``.

Observations, rewards, dones and their numbers are those of :mod:`stripe_tasks.locomotion.direct`.
"""

from __future__ import annotations

import warp as wp

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
    TermState,
)
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg

from . import terms
from .direct import AntEnvCfg, AntPPORunnerCfg, HumanoidEnvCfg, HumanoidPPORunnerCfg, LocomotionEnvCfg

__all__ = ["AntManagerEnvCfg", "AntManagerPPORunnerCfg", "HumanoidManagerEnvCfg", "HumanoidManagerPPORunnerCfg"]

ANT = AntEnvCfg()
HUMANOID = HumanoidEnvCfg()
LAST_POS = {"last_pos": TermState("last_root_pos", wp.vec2)}


def scene_of(task: LocomotionEnvCfg) -> RobotSceneCfg:
    """Scene of a direct task: its robot on its ground."""
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=task.ground)
    return RobotSceneCfg(
        num_envs=task.scene.num_envs, env_spacing=task.scene.env_spacing, robot=task.robot, ground=ground
    )


def observations_of(task: LocomotionEnvCfg) -> ObservationsCfg:
    """Observation terms with the numbers of a direct task."""
    target = {"target_distance": task.target_distance}
    policy = ObservationsCfg.PolicyCfg(
        base_ang_vel=ObservationTermCfg(func=mdp.base_ang_vel, scale=task.ang_vel_scale),
        base_angle_to_target=ObservationTermCfg(func=terms.base_angle_to_target, size=1, params=target),
        base_heading_proj=ObservationTermCfg(func=terms.base_heading_proj, size=1, params=target),
        joint_vel=ObservationTermCfg(func=mdp.joint_vel, scale=task.joint_vel_scale),
        actions=ObservationTermCfg(func=terms.last_action, size=task.action_space),
    )
    return ObservationsCfg(policy=policy)


def actions_of(task: LocomotionEnvCfg) -> ActionsCfg:
    """Action term of a direct task: for an action of one the effort is the gear, which also limits it."""
    efforts = {name: task.action_scale * gear for name, gear in task.joint_gears.items()}
    clip = {name: (-effort, effort) for name, effort in efforts.items()}
    action = mdp.JointEffortActionCfg(asset_name="robot", joint_names=[".*"], scale=efforts, clip=clip)
    return ActionsCfg(joint_effort=action)


def rewards_of(task: LocomotionEnvCfg) -> RewardsCfg:
    """Reward terms with the weights of a direct task."""
    target = {"target_distance": task.target_distance}
    strongest = max(task.joint_gears.values())
    gear_ratio = {name: gear / strongest for name, gear in task.joint_gears.items()}
    return RewardsCfg(
        progress=RewardTermCfg(func=terms.progress_reward, weight=1.0, params={**LAST_POS, **target}),
        alive=RewardTermCfg(func=mdp.is_alive, weight=task.alive_reward),
        upright=RewardTermCfg(
            func=terms.upright_posture_bonus, weight=task.up_weight, params={"threshold": float(terms.UPRIGHT)}
        ),
        move_to_target=RewardTermCfg(
            func=terms.move_to_target_bonus,
            weight=task.heading_weight,
            params={"threshold": float(terms.FACING), **target},
        ),
        action_l2=RewardTermCfg(func=terms.action_l2, weight=-task.actions_cost),
        energy=RewardTermCfg(
            func=terms.power_consumption,
            # the direct form takes the power of its scaled joint velocities
            weight=-task.power_cost * task.joint_vel_scale,
            params={"gear_ratio": gear_ratio},
        ),
        joint_pos_limits=RewardTermCfg(
            func=terms.joint_pos_limits_penalty,
            weight=-task.at_limit_cost,
            params={"threshold": float(terms.NEAR_LIMIT)},
        ),
        death=RewardTermCfg(func=mdp.is_terminated, weight=task.death_cost),
    )


def terminations_of(task: LocomotionEnvCfg) -> TerminationsCfg:
    """Termination terms with the numbers of a direct task."""
    height = {"minimum_height": task.termination_height}
    return TerminationsCfg(torso_height=TerminationTermCfg(func=mdp.root_height_below_minimum, params=height))


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The torso's height, motion and direction, the joints, the last actions."""

        base_height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)
        base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel)
        base_ang_vel: ObservationTermCfg = MISSING
        base_yaw_roll: ObservationTermCfg = ObservationTermCfg(func=terms.base_yaw_roll, size=2)
        base_angle_to_target: ObservationTermCfg = MISSING
        base_up_proj: ObservationTermCfg = ObservationTermCfg(func=terms.base_up_proj, size=1)
        base_heading_proj: ObservationTermCfg = MISSING
        joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_limit_normalized)
        joint_vel: ObservationTermCfg = MISSING
        actions: ObservationTermCfg = MISSING

    policy: PolicyCfg = MISSING


@configclass
class ActionsCfg:
    """Actions: an effort at each joint."""

    joint_effort: mdp.JointEffortActionCfg = MISSING


@configclass
class RewardsCfg:
    """Rewards for progress, facing the target and staying up, less effort, power and joints near their limits."""

    progress: RewardTermCfg = MISSING
    alive: RewardTermCfg = MISSING
    upright: RewardTermCfg = MISSING
    move_to_target: RewardTermCfg = MISSING
    action_l2: RewardTermCfg = MISSING
    energy: RewardTermCfg = MISSING
    joint_pos_limits: RewardTermCfg = MISSING
    death: RewardTermCfg = MISSING


@configclass
class TerminationsCfg:
    """An episode ends when the torso is too low, or after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    torso_height: TerminationTermCfg = MISSING


@configclass
class EventsCfg:
    """An episode starts with the default state of the robot.

    Events run in the order of their fields: the position is remembered after the root is reset.
    """

    reset_root: EventTermCfg = EventTermCfg(func=mdp.reset_root_to_default, mode="reset")
    reset_joints: EventTermCfg = EventTermCfg(func=mdp.reset_joints_to_default, mode="reset")
    remember_position: EventTermCfg = EventTermCfg(func=terms.remember_position, mode="reset", params=LAST_POS)


@configclass
class AntManagerEnvCfg(ManagerBasedRLEnvCfg):
    """Manager-based ant: 36 observations, 8 joint torques."""

    decimation: int = ANT.decimation
    episode_length_s: float = ANT.episode_length_s
    sim: SimulationCfg = ANT.sim
    scene: RobotSceneCfg = scene_of(ANT)
    observations: ObservationsCfg = observations_of(ANT)
    actions: ActionsCfg = actions_of(ANT)
    rewards: RewardsCfg = rewards_of(ANT)
    terminations: TerminationsCfg = terminations_of(ANT)
    events: EventsCfg = EventsCfg()
    scale_rewards_by_dt: bool = False  # as the direct form, whose rewards are those of a step


@configclass
class HumanoidManagerEnvCfg(AntManagerEnvCfg):
    """Manager-based humanoid: 75 observations, 21 joint torques."""

    decimation: int = HUMANOID.decimation
    episode_length_s: float = HUMANOID.episode_length_s
    sim: SimulationCfg = HUMANOID.sim
    scene: RobotSceneCfg = scene_of(HUMANOID)
    observations: ObservationsCfg = observations_of(HUMANOID)
    actions: ActionsCfg = actions_of(HUMANOID)
    rewards: RewardsCfg = rewards_of(HUMANOID)
    terminations: TerminationsCfg = terminations_of(HUMANOID)


@configclass
class AntManagerPPORunnerCfg(AntPPORunnerCfg):
    """PPO that makes the ant run."""

    experiment_name: str = "ant"


@configclass
class HumanoidManagerPPORunnerCfg(HumanoidPPORunnerCfg):
    """PPO that makes the humanoid run."""

    experiment_name: str = "humanoid"
