# SPDX-License-Identifier: Apache-2.0
"""Direct quadcopter in Warp: it flies to a goal and hovers there: ``Stripe-Quadcopter-Direct-v0``.

Observations, actions, rewards, dones and their numbers are those of Isaac Lab's ``Isaac-Quadcopter-Direct-v0``. The
robot is that of :mod:`stripe_tasks.quadcopter.crazyflie`. Each hook is one kernel.
"""

from __future__ import annotations

from typing import Any, ClassVar

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData, EpisodeData
from stripe_kernels.episode import log_add
from stripe_kernels.mdp import frames, random
from stripe_newton.assets import Articulation, ArticulationCfg, RigidObject, RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.goal_marker import GoalMarked, goal_marker, origin_frames
from stripe_tasks.robot_scene import spawn_scenery

from .crazyflie import CRAZYFLIE_CFG

__all__ = ["QuadcopterEnv", "QuadcopterEnvCfg", "QuadcopterPPORunnerCfg"]


@wp.struct
class Numbers:
    """Numbers of a :class:`QuadcopterEnvCfg` for kernels, under the names that they have there."""

    full_thrust: float
    moment_scale: float
    lin_vel_reward_scale: float
    ang_vel_reward_scale: float
    distance_to_goal_reward_scale: float
    distance_scale: float
    heights: wp.vec2
    goal_distance: float
    goal_heights: wp.vec2


@wp.kernel(enable_backward=False)
def set_wrench(actions: wp.array2d[float], robot: ArticulationData, numbers: Numbers) -> None:
    """Set the thrust along the body's z axis, from none at -1 to full at 1, and a moment about each axis."""
    env = wp.tid()
    thrust = 0.5 * (wp.clamp(actions[env, 0], -1.0, 1.0) + 1.0) * numbers.full_thrust
    moment = wp.vec3()
    for i in range(3):
        moment[i] = numbers.moment_scale * wp.clamp(actions[env, 1 + i], -1.0, 1.0)
    robot.external_wrench[env, 0] = wp.spatial_vector(wp.vec3(0.0, 0.0, thrust), moment)


@wp.kernel(enable_backward=False)
def compute_dones(
    robot: ArticulationData,
    episode: EpisodeData,
    numbers: Numbers,
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
) -> None:
    """End an episode when the quadcopter is too low or too high, or after its full length."""
    env = wp.tid()
    z = wp.transform_get_translation(robot.root_pose[env])[2]
    terminated[env] = z < numbers.heights[0] or z > numbers.heights[1]
    truncated[env] = mdp.time_out(env, episode)


@wp.func
def goal_in_world(env: int, robot: ArticulationData, goal: wp.array[wp.transform]) -> wp.vec3:
    """Position of the goal [m]."""
    return robot.env_origin[env] + wp.transform_get_translation(goal[env])


@wp.kernel(enable_backward=False)
def compute_rewards(
    robot: ArticulationData,
    episode: EpisodeData,
    goal: wp.array[wp.transform],
    numbers: Numbers,
    log_sums: wp.array[float],
    log_counts: wp.array[int],
    log_distance: int,
    reward: wp.array[float],
) -> None:
    """Reward being near the goal, less linear and angular speed; scales are per second.

    Formula: ``dt (a |v|^2 + b |w|^2 + c (1 - tanh(d / s)))``, d the distance to the goal.
    """
    env = wp.tid()
    v, w = frames.root_lin_vel_b(env, robot), frames.root_ang_vel_b(env, robot)
    distance = wp.length(goal_in_world(env, robot, goal) - wp.transform_get_translation(robot.root_pose[env]))
    total = numbers.lin_vel_reward_scale * wp.dot(v, v) + numbers.ang_vel_reward_scale * wp.dot(w, w)
    total += numbers.distance_to_goal_reward_scale * (1.0 - wp.tanh(distance / numbers.distance_scale))
    reward[env] = episode.step_dt * total
    log_add(log_sums, log_counts, log_distance, distance)


@wp.kernel(enable_backward=False)
def reset_envs(
    mask: wp.array[wp.bool],
    robot: ArticulationData,
    goal: wp.array[wp.transform],
    rng: wp.array[wp.uint32],
    numbers: Numbers,
) -> None:
    """Reset the quadcopter to its default state and draw a goal, in the environment's frame."""
    env = wp.tid()
    if mask[env]:
        mdp.reset_root_to_default(env, robot)
        sides = wp.vec2(-numbers.goal_distance, numbers.goal_distance)
        x = random.uniform_range(env, rng, sides)
        y = random.uniform_range(env, rng, sides)
        z = random.uniform_range(env, rng, numbers.goal_heights)
        goal[env] = wp.transform(wp.vec3(x, y, z), wp.quat_identity())


@wp.kernel(enable_backward=False)
def compute_observations(robot: ArticulationData, goal: wp.array[wp.transform], out: wp.array2d[float]) -> None:
    """Write the observations in the order that :class:`QuadcopterEnv` gives."""
    env = wp.tid()
    mdp.base_lin_vel(env, robot, out[env, 0:3])
    mdp.base_ang_vel(env, robot, out[env, 3:6])
    mdp.projected_gravity(env, robot, out[env, 6:9])
    to_goal = wp.transform_point(wp.transform_inverse(robot.root_pose[env]), goal_in_world(env, robot, goal))
    for i in range(3):
        out[env, 9 + i] = to_goal[i]


@configclass
class QuadcopterEnvCfg(DirectRLEnvCfg):
    """Direct quadcopter: 12 observations, a thrust and three moments.

    An episode ends near the ground, too high up, or after 10 s.
    """

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 2
    episode_length_s: float = 10.0
    action_space: int = 4
    observation_space: int = 12
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 100.0,
        render_interval=2,
        solver=MuJoCoSolverCfg(disable_contacts=True),  # an episode ends before the ground is reached
    )
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=4096, env_spacing=2.5)
    viewer: ViewerCfg = ViewerCfg(
        eye=(0.45, -0.65, 0.3), lookat=(0.0, 0.0, 0.0), origin_type="asset_root", asset_name="Robot"
    )
    robot: ArticulationCfg = CRAZYFLIE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    goal: RigidObjectCfg = goal_marker("ball", 0.015)
    thrust_to_weight: float = 1.9
    """Thrust for an action of one, as a multiple of the weight."""
    moment_scale: float = 0.01
    """Moment about each axis of the body for an action of one [N m]."""
    lin_vel_reward_scale: float = -0.05
    """Weight of the squared speed [m/s], per second."""
    ang_vel_reward_scale: float = -0.01
    """Weight of the squared angular speed [rad/s], per second."""
    distance_to_goal_reward_scale: float = 15.0
    """Reward for being at the goal, per second."""
    distance_scale: float = 0.8
    """Distance to the goal at which that reward has fallen by tanh(1), to 24 % [m]."""
    heights: tuple[float, float] = (0.1, 2.0)
    """Heights below and above which an episode ends [m]."""
    goal_distance: float = 2.0
    """Largest distance of goals from the origin of the environment, along x and along y [m]."""
    goal_heights: tuple[float, float] = (0.5, 1.5)
    """Heights of goals [m]."""


class QuadcopterEnv(GoalMarked, DirectRLEnv):
    """Fly to a goal and hover there.

    Observations, in the body's frame: linear velocity, angular velocity, direction of gravity, vector to the goal.
    """

    cfg: QuadcopterEnvCfg

    def __init__(self, cfg: QuadcopterEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        self.sim.enable_external_wrench()  # rotors have no joints: they are a wrench on the body
        weight = float(self.robot.data.default_mass.sum(dim=1)[0]) * float(-self.sim.model.gravity.numpy()[0, 2])
        numbers: Any = Numbers()
        for name in numbers._cls.vars:
            if name != "full_thrust":
                setattr(numbers, name, getattr(self.cfg, name))
        numbers.full_thrust = self.cfg.thrust_to_weight * weight
        # goals lie in an array of the context, which is saved with a checkpoint
        self._numbers, self._goal = numbers, self.context.array("goal", wp.transform)
        self._log_distance = self.warp.log.add("Metrics/distance_to_goal", "mean")

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        self.scene.rigid_objects["goal"] = RigidObject(self.cfg.goal)
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _goals(self) -> tuple[wp.array, wp.array]:
        return origin_frames(self.scene), self._goal

    def _launch(self, kernel: wp.Kernel, *arguments: Any) -> None:
        wp.launch(kernel, dim=self.num_envs, inputs=arguments, device=self.device)

    def _launch_pre_physics_step(self, actions: wp.array2d[float]) -> None:
        self._launch(set_wrench, actions, self.robot.data.struct, self._numbers)

    def _launch_dones(self) -> None:
        w, robot = self.warp, self.robot.data.struct
        self._launch(compute_dones, robot, w.episode, self._numbers, w.terminated, w.truncated)

    def _launch_rewards(self) -> None:
        w, robot = self.warp, self.robot.data.struct
        state = robot, w.episode, self._goal, self._numbers
        self._launch(compute_rewards, *state, w.log.sums, w.log.counts, self._log_distance, w.reward)

    def _launch_reset(self, env_mask: wp.array[wp.bool]) -> None:
        self._launch(reset_envs, env_mask, self.robot.data.struct, self._goal, self.warp.rng, self._numbers)

    def _launch_observations(self) -> None:
        self._launch(compute_observations, self.robot.data.struct, self._goal, self.warp.observations["policy"])


@configclass
class QuadcopterPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for the quadcopter."""

    num_steps_per_env: int = 24
    max_iterations: int = 200
    save_interval: int = 50
    experiment_name: str = "quadcopter_direct"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(64, 64),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(64, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.0)
