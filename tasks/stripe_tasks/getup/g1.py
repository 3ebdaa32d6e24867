# SPDX-License-Identifier: Apache-2.0
"""Recovery of Unitree's G1 from falls: ``Stripe-Getup-Flat-G1-v0``.

An episode begins with the robot dropped in any orientation and pose. Rewards follow those of MuJoCo Playground's getup
tasks: height and uprightness, and once the robot is up its pose and stillness. The height is that of the head, as in
HoST (Huang et al. 2025): with the height of the waist, and uprightness that does not tell up from down, robots learn to
stand on their heads. As in HoST, a force lifts robots that do not get up by themselves
(:mod:`stripe_tasks.getup.assistance`), and actions reach further than those of walking.
"""

from __future__ import annotations

import math

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
from stripe_newton.rl import RslRlMLPModelCfg
from stripe_newton.sim import MuJoCoSolverCfg, RigidBodyMaterialCfg, SimulationCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.published_robots import G1_DRIVES, action_scale, g1_cfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.success import SuccessManagerCfg
from stripe_tasks.velocity.manager_based import VelocityPPORunnerCfg
from stripe_tasks.velocity.manager_terms import noise

from . import assistance, terms

__all__ = ["GetupEnvCfg", "GetupPPORunnerCfg"]

TORSO = SceneEntityCfg("robot", body_names="torso_link")
HEAD = {"asset_cfg": TORSO, "length": 0.45, "target_height": 1.2}
"""Place of the head above the torso's frame, which is at the waist, and its height when the robot stands [m]."""
LEAST_HEIGHT, LARGEST_TILT = 0.65, math.radians(20.0)
"""Height of the torso's frame [m] and tilt of the root [rad] of a robot that stands; by default the former is 0.80."""
UP = {"asset_cfg": TORSO, "least_height": LEAST_HEIGHT}
REACH = 2.0
"""Scale of actions in multiples of that for walking: legs fold and arms push further."""


@configclass
class PolicyCfg(ObservationGroupCfg):
    """Rates, direction of gravity, joints and last actions, with the noise of the sensors."""

    base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel, noise=noise(0.2))
    projected_gravity: ObservationTermCfg = ObservationTermCfg(func=mdp.projected_gravity, noise=noise(0.05))
    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel, noise=noise(0.01))
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel, noise=noise(1.5))
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)
    enable_corruption: bool = True


@configclass
class CriticCfg(PolicyCfg):
    """The same without noise, and the height and velocity of the root, and how much the robot is lifted."""

    base_pos_z: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)
    base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel)
    assistance: ObservationTermCfg | None = ObservationTermCfg(func=assistance.assistance_level)
    enable_corruption: bool = False


@configclass
class ObservationsCfg:
    """Observations: with noise for the policy, without noise for the critic."""

    policy: PolicyCfg = PolicyCfg()
    critic: CriticCfg = CriticCfg()


@configclass
class ActionsCfg:
    """Actions: positions of the joints, relative to the default pose."""

    joint_pos: mdp.JointPositionActionCfg = mdp.JointPositionActionCfg(
        asset_name="robot",
        joint_names=[".*"],
        scale={joints: REACH * scale for joints, scale in action_scale(G1_DRIVES).items()},
        use_default_offset=True,
    )


@configclass
class RewardsCfg:
    """Rewards for being up and upright, and then for standing still, less costs of rough motion."""

    rising: RewardTermCfg = RewardTermCfg(func=terms.head_height, weight=1.0, params=HEAD)
    head_height: RewardTermCfg = RewardTermCfg(func=terms.head_height_exp, weight=2.0, params={**HEAD, "std": 0.4})
    upright: RewardTermCfg = RewardTermCfg(func=terms.uprightness, weight=1.0, params={"asset_cfg": TORSO})
    posture: RewardTermCfg = RewardTermCfg(func=terms.posture_standing_exp, weight=1.0, params={**UP, "std": 0.5})
    stand_still: RewardTermCfg = RewardTermCfg(func=terms.joint_vel_standing_exp, weight=1.0, params={**UP, "std": 2.0})
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.002)
    joint_pos_limits: RewardTermCfg = RewardTermCfg(func=mdp.joint_pos_limits, weight=-0.5)
    joint_torques_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_torques_l2, weight=-1.0e-5)
    joint_acc_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_acc_l2, weight=-2.5e-7)


@configclass
class CurriculumCfg:
    """Curriculum: the cost of changes of actions grows tenfold from the 400th to the 1000th iteration."""

    action_rate: CurriculumTermCfg | None = CurriculumTermCfg(
        func=mdp.modify_term_cfg,
        params={"address": "rewards.action_rate_l2.weight", "value": -0.02, "start_step": 9600, "num_steps": 24000},
    )


@configclass
class TerminationsCfg:
    """An episode ends after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)


@configclass
class EventsCfg:
    """An episode begins with the robot dropped in any orientation and pose; friction and mass differ."""

    payload: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={"asset_cfg": TORSO, "mass_distribution_params": (-1.0, 2.0), "operation": "add"},
    )
    friction: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={"asset_cfg": SceneEntityCfg("robot", body_names=".*"), "static_friction_range": (0.5, 1.2)},
    )
    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_with_random_orientation,
        mode="reset",
        params={"pose_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "z": (0.0, 0.2)}, "velocity_range": {}},
    )
    reset_robot_joints: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (-0.6, 0.6), "velocity_range": (-0.5, 0.5)},
    )


@configclass
class GetupEnvCfg(ManagerBasedRLEnvCfg):
    """G1 that gets up: 93 observations, 29 joint positions, episodes of 6 s.

    An episode is a success where the robot stands at its end without help: the torso's frame, at the waist, above
    0.65 m, and the root within 20 degrees.
    """

    decimation: int = 4
    episode_length_s: float = 6.0
    scene: RobotSceneCfg = RobotSceneCfg(num_envs=4096, env_spacing=2.5)
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=300, nconmax=80, drive_limits=True),
        physics_material=RigidBodyMaterialCfg(static_friction=0.5, dynamic_friction=0.5),
    )
    viewer: ViewerCfg = ViewerCfg(
        origin_type="asset_root",
        asset_name="Robot",
        eye=(2.2, -2.4, 0.8),
        lookat=(0.0, 0.0, -0.1),
        num_shown=4,
    )
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()
    managers = {
        "assistance": assistance.AssistanceManagerCfg(
            body_name="torso_link", least_height=LEAST_HEIGHT, largest_tilt=LARGEST_TILT
        ),
        "success": SuccessManagerCfg(func=assistance.stands_unassisted, params={**UP, "largest_tilt": LARGEST_TILT}),
    }

    def __post_init__(self) -> None:
        self.scene.robot = g1_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")


@configclass
class GetupPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for getting up."""

    experiment_name: str = "getup_flat_g1"
    max_iterations: int = 1500

    def __post_init__(self) -> None:
        # The usual spread and entropy make robots thrash about for longer than it takes to learn to get up.
        self.algorithm.entropy_coef = 0.005
        self.actor.distribution_cfg = RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.6)
