# SPDX-License-Identifier: Apache-2.0
"""Push ball: an ant pushes a ball, one of the object manager's pool, to a goal: ``Stripe-PushBall-Ant-v0``."""

from __future__ import annotations

import torch
import warp as wp

from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    MetricTermCfg,
    ObjectPoolCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    PreviewSurfaceCfg,
    RigidBodyPropertiesCfg,
    SimulationCfg,
)
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.goal_marker import GoalMarked, goal_marker, origin_frames
from stripe_tasks.locomotion import AntEnvCfg, AntPPORunnerCfg
from stripe_tasks.locomotion import terms as locomotion_terms
from stripe_tasks.locomotion.manager_based import ActionsCfg, actions_of
from stripe_tasks.robot_scene import RobotSceneCfg

from . import terms
from .rolling_ball import RollingBallCfg

__all__ = [
    "EventsCfg",
    "MetricsCfg",
    "ObjectsCfg",
    "ObservationsCfg",
    "PushBallEnv",
    "PushBallEnvCfg",
    "PushBallPPORunnerCfg",
    "PushBallSceneCfg",
    "RewardsCfg",
    "TerminationsCfg",
]

ANT = AntEnvCfg()
BALL = {"pool_name": "balls"}
RADIUS, MASS = 0.25, 0.2
REACHED = 0.35
"""Distance between ball and goal that counts as reached [m]."""
PUSH_DISTANCE = 0.5
"""Distance behind the ball of the place to which the ant is led [m]."""


@configclass
class PushBallSceneCfg(RobotSceneCfg):
    """Scene with the ant on the ground, and a disc that marks the goal."""

    goal: RigidObjectCfg = goal_marker("disc", REACHED, color=(0.1, 0.55, 0.2), offset=0.01 - RADIUS)


@configclass
class ObjectsCfg:
    """Objects: a ball of 0.2 kg in front of the ant, and its goal farther ahead."""

    balls: ObjectPoolCfg = ObjectPoolCfg(
        objects=RigidObjectCfg(
            prim_path="{ENV_REGEX_NS}/Ball",
            spawn=RollingBallCfg(
                radius=RADIUS,
                rigid_props=RigidBodyPropertiesCfg(),
                collision_props=CollisionPropertiesCfg(),
                mass_props=MassPropertiesCfg(mass=MASS),
                visual_material=PreviewSurfaceCfg(diffuse_color=(0.9, 0.28, 0.04)),
            ),
            init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, RADIUS)),
        ),
        count=1,
        pose_range={"x": (1.4, 2.0), "y": (-0.6, 0.6), "yaw": (-3.14, 3.14)},
        target_range={"x": (3.2, 4.2), "y": (-0.8, 0.8)},
        min_robot_distance=1.3,
    )


@configclass
class ObservationsCfg:
    """Observations of the policy."""

    @configclass
    class PolicyCfg(ObservationGroupCfg):
        """The torso's height, motion and direction of gravity, the joints, ball and goal, the last actions."""

        base_height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)
        base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel)
        base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel)
        projected_gravity: ObservationTermCfg = ObservationTermCfg(func=mdp.projected_gravity)
        joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_limit_normalized)
        joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel, scale=ANT.joint_vel_scale)
        ball_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.object_positions_b, params=BALL)
        ball_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.object_velocities_b, params=BALL)
        goal_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.object_target_positions_b, params=BALL)
        actions: ObservationTermCfg = ObservationTermCfg(func=locomotion_terms.last_action, size=ANT.action_space)

    policy: PolicyCfg = PolicyCfg()


@configclass
class RewardsCfg:
    """Rewards of a step: the ball moves to the goal, the ant to the place from which it pushes, and stays up."""

    ball_to_goal: RewardTermCfg = RewardTermCfg(func=mdp.object_velocity_toward_goal, weight=2.0, params=BALL)
    ball_near_goal: RewardTermCfg = RewardTermCfg(
        func=mdp.object_moved_to_goal, weight=0.5, params={**BALL, "std": 1.0}
    )
    goal_reached: RewardTermCfg = RewardTermCfg(
        func=mdp.is_terminated_term, weight=200.0, params={"term_keys": "goal_reached"}
    )
    ant_to_ball: RewardTermCfg = RewardTermCfg(
        func=terms.robot_velocity_toward_push, weight=1.0, params={**BALL, "distance": PUSH_DISTANCE}
    )
    alive: RewardTermCfg = RewardTermCfg(func=mdp.is_alive, weight=ANT.alive_reward)
    upright: RewardTermCfg = RewardTermCfg(
        func=locomotion_terms.upright_posture_bonus,
        weight=ANT.up_weight,
        params={"threshold": float(locomotion_terms.UPRIGHT)},
    )
    action_l2: RewardTermCfg = RewardTermCfg(func=locomotion_terms.action_l2, weight=-ANT.actions_cost)
    death: RewardTermCfg = RewardTermCfg(
        func=mdp.is_terminated_term, weight=ANT.death_cost, params={"term_keys": ["torso_height", "ball_lost"]}
    )


@configclass
class TerminationsCfg:
    """An episode ends when the ball is at the goal or lost, when the torso is too low, or after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    goal_reached: TerminationTermCfg = TerminationTermCfg(
        func=mdp.object_reached_goal, params={**BALL, "threshold": REACHED}
    )
    torso_height: TerminationTermCfg = TerminationTermCfg(
        func=mdp.root_height_below_minimum, params={"minimum_height": ANT.termination_height}
    )
    ball_lost: TerminationTermCfg = TerminationTermCfg(
        func=mdp.object_out_of_bounds, params={**BALL, "lower": (-3.0, -4.0, -1.0), "upper": (6.0, 4.0, 2.0)}
    )


@configclass
class EventsCfg:
    """An episode starts with the ant in its default state, turned a little."""

    reset_root: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform,
        mode="reset",
        params={"pose_range": {"yaw": (-0.5, 0.5)}, "velocity_range": {}},
    )
    reset_joints: EventTermCfg = EventTermCfg(func=mdp.reset_joints_to_default, mode="reset")


@configclass
class MetricsCfg:
    """Metric: the mean speed of the ball toward the goal [m/s]."""

    ball_speed: MetricTermCfg = MetricTermCfg(func=mdp.object_velocity_toward_goal, params=BALL)


@configclass
class PushBallEnvCfg(ManagerBasedRLEnvCfg):
    """Push ball with an ant: 43 observations, 8 joint torques, episodes of at most 12 s."""

    decimation: int = ANT.decimation
    episode_length_s: float = 12.0
    sim: SimulationCfg = ANT.sim.replace(
        # The ball is away from the ant at first, so buffers sized by the first state would be too small.
        solver=MuJoCoSolverCfg(iterations=20, ls_iterations=10, nconmax=48, njmax=192)
    )
    scene: PushBallSceneCfg = PushBallSceneCfg(
        num_envs=4096,
        env_spacing=8.0,
        robot=ANT.robot,
        ground=AssetBaseCfg(prim_path="/World/ground", spawn=ANT.ground),
    )
    viewer: ViewerCfg = ViewerCfg(eye=(2.0, -5.2, 2.6), lookat=(2.0, 0.0, 0.2))
    objects: ObjectsCfg = ObjectsCfg()
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = actions_of(ANT)
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()
    metrics: MetricsCfg = MetricsCfg()
    scale_rewards_by_dt: bool = False


class PushBallEnv(GoalMarked, ManagerBasedRLEnv):
    """Push ball: a manager-based environment that shows the ball's goal."""

    cfg: PushBallEnvCfg

    @property
    def success(self) -> torch.Tensor:
        """Whether the ball was at the goal in the last step, bool, shape ``(num_envs,)``."""
        return self.termination_manager.get_term("goal_reached")

    def _goals(self) -> tuple[wp.array, wp.array]:
        target = self.object_manager["balls"].target[:, 0]
        return origin_frames(self.scene), wp.from_torch(target, dtype=wp.transform)


@configclass
class PushBallPPORunnerCfg(AntPPORunnerCfg):
    """PPO for pushing the ball."""

    max_iterations: int = 500
    experiment_name: str = "push_ball_ant"
