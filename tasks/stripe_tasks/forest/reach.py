# SPDX-License-Identifier: Apache-2.0
"""Forest reach: a quadruped goes to a goal 10 to 20 m away through the trees: ``Stripe-Forest-Reach-Quadruped-v0``.

The levels are those of :mod:`stripe_tasks.forest.walk`. ``Stripe-Forest-Reach-Quadruped-Play-v0`` is the same task in
ordinary woods that no policy is trained in.
"""

from __future__ import annotations

import torch
import warp as wp

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import CurriculumTermCfg, ObservationTermCfg, RewardTermCfg, TerminationTermCfg
from stripe_newton.rl import RslRlPpoAlgorithmCfg
from stripe_newton.specifications import TaskEnvCfg, TrainingSpec
from stripe_tasks import navigation_terms
from stripe_tasks.goal_marker import GoalMarked, goal_marker

from . import walk

__all__ = ["ForestReachEnv", "ForestReachPPORunnerCfg", "play_cfg", "reach_cfg", "training"]

GOAL = {"command_name": "goal"}
REACHED = 0.5
"""Distance from the goal that counts as reached [m]."""
SPEED = 1.0
"""Wanted speed; more is not rewarded [m/s]."""
EPISODE = 35.0
"""Length of an episode [s]."""


@configclass
class ReachCommandsCfg:
    """Command: a goal where a robot can stand, 10 to 20 m away, for the whole episode."""

    goal: mdp.TerrainBasedPose2dCommandCfg = mdp.TerrainBasedPose2dCommandCfg(
        asset_name="robot",
        # one goal for an episode: reaching it ends the episode
        resampling_time_range=(1.0e6, 1.0e6),
        simple_heading=True,
        ranges=mdp.TerrainBasedPose2dCommandCfg.Ranges(distance=(10.0, 20.0)),
    )


@configclass
class ReachPolicyCfg(walk.WalkPolicyCfg):
    """Observations of the robot itself, the ground, the trunks around it, and the goal."""

    velocity_commands: ObservationTermCfg | None = None
    goal_vector: ObservationTermCfg = ObservationTermCfg(
        func=navigation_terms.goal_vector, params={**GOAL, "near": 3.0}, size=3
    )


@configclass
class ReachObservationsCfg:
    """Observations: with noise for the policy, without noise for the critic."""

    policy: ReachPolicyCfg = ReachPolicyCfg()
    critic: ReachPolicyCfg = ReachPolicyCfg(enable_corruption=False)


@configclass
class ReachRewardsCfg(walk.ForestRewardsCfg):
    """Rewards for moving to the goal and facing it, less costs of unsteady motion."""

    track_lin_vel_xy_exp: RewardTermCfg | None = None
    track_ang_vel_z_exp: RewardTermCfg | None = None
    velocity_toward_goal: RewardTermCfg = RewardTermCfg(
        func=navigation_terms.velocity_toward_goal, weight=2.0, params={**GOAL, "speed": SPEED}
    )
    facing_goal: RewardTermCfg = RewardTermCfg(func=navigation_terms.facing_goal, weight=0.1, params=GOAL)
    reached: RewardTermCfg = RewardTermCfg(
        func=mdp.is_terminated_term, weight=500.0, params={"term_keys": "goal_reached"}
    )
    # it reads a velocity command, which this task does not have
    feet_air_time: RewardTermCfg | None = None


@configclass
class ReachTerminationsCfg(walk.ForestTerminationsCfg):
    """An episode also ends at the goal."""

    goal_reached: TerminationTermCfg = TerminationTermCfg(
        func=navigation_terms.goal_reached, params={**GOAL, "threshold": REACHED}
    )


@configclass
class ReachCurriculumCfg:
    """Curriculum: robots that reach their goal go on to denser and steeper woods."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(
        func=navigation_terms.terrain_levels_goal, params={**GOAL, "threshold": REACHED}
    )


class ForestReachEnv(GoalMarked, ManagerBasedRLEnv):
    """Forest reach: a manager-based environment that shows the goal."""

    @property
    def success(self) -> torch.Tensor:
        """Whether the robot was at its goal in the last step, bool, shape ``(num_envs,)``."""
        return self.termination_manager.get_term("goal_reached")

    def _goals(self) -> tuple[wp.array, ...]:
        return (self.context.arrays["commands.goal.pos"],)


def training(scene: walk.SceneSpec | None = None, **changes: object) -> TrainingSpec:
    """Specification of the task of reaching a goal; see :func:`stripe_tasks.forest.walk.training`."""
    marker: RigidObjectCfg = goal_marker("ball", 0.18, color=(0.95, 0.3, 0.02), offset=0.15)
    fields = {
        "observations": ReachObservationsCfg(),
        "rewards": ReachRewardsCfg(),
        "terminations": ReachTerminationsCfg(),
        "commands": ReachCommandsCfg(),
        "curriculum": ReachCurriculumCfg(),
        "assets": {"goal": marker},
        **changes,
    }
    return walk.training(scene, **fields)


def reach_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Reach-Quadruped-v0``."""
    return training().to_env_cfg(walk.VIEWER, episode_length_s=EPISODE, seed=walk.SCENE_SEED)


def play_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Reach-Quadruped-Play-v0``."""
    return walk.to_play(training).to_env_cfg(walk.VIEWER, episode_length_s=EPISODE, seed=walk.PLAY_SEED)


@configclass
class ForestReachPPORunnerCfg(walk.ForestPPORunnerCfg):
    """PPO for forest reach, with a discount that looks farther ahead than for walking."""

    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.004, learning_rate=1.0e-3, gamma=0.995)
    experiment_name: str = "forest_reach_quadruped"
