# SPDX-License-Identifier: Apache-2.0
"""In-hand reorientation in Warp: an Allegro hand turns a cube to goals: ``Stripe-Repose-Cube-Allegro-Direct-v0``.

Observations, actions, rewards, dones and their numbers are those of Isaac Lab's task of this name. The hand is that of
MuJoCo Menagerie, its palm up. Each hook is one kernel.
"""

from __future__ import annotations

from typing import Any, ClassVar

import warp as wp

from stripe_kernels.data import ArticulationData, EpisodeData
from stripe_kernels.episode import log_add
from stripe_kernels.mdp import frames, random
from stripe_newton.assets import Articulation, ArticulationCfg, RigidObject, RigidObjectCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
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
from stripe_tasks.goal_marker import GoalMarked, goal_marker, origin_frames
from stripe_tasks.published_robots import allegro_cfg
from stripe_tasks.robot_scene import spawn_scenery

__all__ = ["ReposeEnv", "ReposeEnvCfg", "ReposePPORunnerCfg"]

SIZE = 0.065
"""Length of the cube's edges [m]."""
TIPS = ["ff_tip", "mf_tip", "rf_tip", "th_tip"]
_JOINTS = 16
"""Joints of the hand."""


@wp.struct
class Numbers:
    """Numbers of a :class:`ReposeEnvCfg` for kernels, under the names that they have there."""

    reset_position_noise: float
    reset_dof_pos_noise: float
    dist_reward_scale: float
    rot_reward_scale: float
    rot_eps: float
    action_penalty_scale: float
    reach_goal_bonus: float
    fall_penalty: float
    fall_dist: float
    vel_obs_scale: float
    success_tolerance: float
    act_moving_average: float
    in_hand_pos: wp.vec3
    marker_pos: wp.vec3


@wp.struct
class Goals:
    """Goals of the environments, and how often they were reached."""

    rot: wp.array[wp.quat]
    """Orientation to turn the cube to, shape ``(num_envs,)``."""
    marker: wp.array[wp.transform]
    """Pose of the marker that shows it, in the environment's frame [m], shape ``(num_envs,)``."""
    successes: wp.array[float]
    """Goals reached in the episode, shape ``(num_envs,)``."""


@wp.func
def draw_rotation(env: int, rng: wp.array[wp.uint32]) -> wp.quat:
    """A turn about x and one about y, both uniform up to half a turn."""
    u = random.uniform_range(env, rng, wp.vec2(-wp.pi, wp.pi))
    v = random.uniform_range(env, rng, wp.vec2(-wp.pi, wp.pi))
    return wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), u) * wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), v)


@wp.func
def draw_goal(env: int, goals: Goals, rng: wp.array[wp.uint32], numbers: Numbers) -> None:
    """Draw a new goal."""
    goals.rot[env] = draw_rotation(env, rng)
    goals.marker[env] = wp.transform(numbers.marker_pos, goals.rot[env])


@wp.func
def object_distance(env: int, cube: ArticulationData, numbers: Numbers) -> float:
    """Distance of the cube from its place in the hand [m]."""
    pos = wp.transform_get_translation(cube.root_pose[env]) - cube.env_origin[env]
    return wp.length(pos - numbers.in_hand_pos)


@wp.kernel(enable_backward=False)
def set_targets(
    asked: wp.array2d[float], actions: wp.array2d[float], robot: ArticulationData, numbers: Numbers
) -> None:
    """Set position targets between the limits of the joints; one thread for each joint.

    Formula: ``q* = a (lower + (upper - lower) (x + 1) / 2) + (1 - a) q*``, ``x`` the action within -1 and 1, ``a`` the
    moving average.
    """
    env, joint = wp.tid()
    action = wp.clamp(asked[env, joint], -1.0, 1.0)
    actions[env, joint] = action
    lower, upper = robot.joint_pos_lower[env, joint], robot.joint_pos_upper[env, joint]
    target = lower + 0.5 * (action + 1.0) * (upper - lower)
    average = numbers.act_moving_average
    robot.joint_pos_target[env, joint] = average * target + (1.0 - average) * robot.joint_pos_target[env, joint]


@wp.kernel(enable_backward=False)
def compute_dones(
    cube: ArticulationData,
    episode: EpisodeData,
    numbers: Numbers,
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
) -> None:
    """End an episode when the cube has fallen out of the hand, or after its full length."""
    env = wp.tid()
    terminated[env] = object_distance(env, cube, numbers) >= numbers.fall_dist
    truncated[env] = episode.length[env] >= episode.max_length - wp.int64(1)


@wp.kernel(enable_backward=False)
def compute_rewards(
    cube: ArticulationData,
    actions: wp.array2d[float],
    goals: Goals,
    rng: wp.array[wp.uint32],
    numbers: Numbers,
    reward: wp.array[float],
) -> None:
    """Reward a cube in its place that is turned to the goal, and reaching it; then the next goal is drawn.

    Formula: ``a d + b / (angle + eps) + c sum_i x_i^2``, plus a bonus where ``angle <= tolerance`` and a penalty where
    ``d >= fall_dist``; ``d`` the distance of the cube from its place.
    """
    env = wp.tid()
    angle = frames.quat_error_magnitude(wp.transform_get_rotation(cube.root_pose[env]), goals.rot[env])
    distance = object_distance(env, cube, numbers)
    effort = wp.float32(0.0)
    for i in range(actions.shape[1]):
        effort += actions[env, i] * actions[env, i]
    total = distance * numbers.dist_reward_scale + numbers.rot_reward_scale / (angle + numbers.rot_eps)
    total += effort * numbers.action_penalty_scale
    if angle <= numbers.success_tolerance:
        total += numbers.reach_goal_bonus
        goals.successes[env] = goals.successes[env] + 1.0
        draw_goal(env, goals, rng, numbers)
    if distance >= numbers.fall_dist:
        total += numbers.fall_penalty
    reward[env] = total


@wp.kernel(enable_backward=False)
def reset_envs(
    mask: wp.array[wp.bool],
    robot: ArticulationData,
    cube: ArticulationData,
    episode: EpisodeData,
    goals: Goals,
    rng: wp.array[wp.uint32],
    numbers: Numbers,
    log_sums: wp.array[float],
    log_counts: wp.array[int],
    log_successes: int,
) -> None:
    """Put the cube into the hand, turned anyhow, bend the fingers anyhow, and draw a goal."""
    env = wp.tid()
    if not mask[env]:
        return
    if episode.length[env] > wp.int64(0):
        log_add(log_sums, log_counts, log_successes, goals.successes[env])
    goals.successes[env] = 0.0
    draw_goal(env, goals, rng, numbers)
    noise = wp.vec2(-numbers.reset_position_noise, numbers.reset_position_noise)
    offset = wp.vec3()
    for k in range(3):
        offset[k] = random.uniform_range(env, rng, noise)
    pos = wp.transform_get_translation(cube.default_root_pose[env]) + cube.env_origin[env] + offset
    cube.root_pose[env] = wp.transform(pos, draw_rotation(env, rng))
    cube.root_vel[env] = wp.spatial_vector()
    for joint in range(robot.joint_pos.shape[1]):
        default = robot.default_joint_pos[env, joint]
        lower = robot.joint_pos_lower[env, joint] - default
        upper = robot.joint_pos_upper[env, joint] - default
        u = random.uniform_range(env, rng, wp.vec2(-1.0, 1.0))
        pos_joint = default + numbers.reset_dof_pos_noise * (lower + (upper - lower) * 0.5 * u)
        pos_joint = wp.clamp(pos_joint, robot.joint_pos_lower[env, joint], robot.joint_pos_upper[env, joint])
        robot.joint_pos[env, joint] = pos_joint
        robot.joint_pos_target[env, joint] = pos_joint
        robot.joint_vel[env, joint] = 0.0


@wp.func
def write_vec3(v: wp.vec3, first: int, out: wp.array[float]) -> None:
    """Write three numbers."""
    for k in range(3):
        out[first + k] = v[k]


@wp.func
def write_quat(q: wp.quat, first: int, out: wp.array[float]) -> None:
    """Write four numbers."""
    for k in range(4):
        out[first + k] = q[k]


@wp.kernel(enable_backward=False)
def compute_observations(
    robot: ArticulationData,
    cube: ArticulationData,
    tips: wp.array[int],
    actions: wp.array2d[float],
    goals: Goals,
    numbers: Numbers,
    observations: wp.array2d[float],
) -> None:
    """Write the observations in the order that :class:`ReposeEnv` gives."""
    env = wp.tid()
    out = observations[env]
    count = robot.joint_pos.shape[1]
    for joint in range(count):
        lower, upper = robot.joint_pos_lower[env, joint], robot.joint_pos_upper[env, joint]
        out[joint] = (2.0 * robot.joint_pos[env, joint] - upper - lower) / (upper - lower)
        out[count + joint] = numbers.vel_obs_scale * robot.joint_vel[env, joint]
    pose, vel = cube.root_pose[env], cube.root_vel[env]
    rot = wp.transform_get_rotation(pose)
    at = 2 * count
    write_vec3(wp.transform_get_translation(pose) - cube.env_origin[env], at, out)
    write_quat(rot, at + 3, out)
    write_vec3(wp.spatial_top(vel), at + 7, out)
    write_vec3(numbers.vel_obs_scale * wp.spatial_bottom(vel), at + 10, out)
    write_vec3(numbers.in_hand_pos, at + 13, out)
    write_quat(goals.rot[env], at + 16, out)
    write_quat(rot * wp.quat_inverse(goals.rot[env]), at + 20, out)
    at = at + 24
    for i in range(tips.shape[0]):
        tip = robot.body_pose[env, tips[i]]
        write_vec3(wp.transform_get_translation(tip) - robot.env_origin[env], at + 3 * i, out)
        write_quat(wp.transform_get_rotation(tip), at + 12 + 4 * i, out)
        motion = robot.body_vel[env, tips[i]]
        write_vec3(wp.spatial_top(motion), at + 28 + 6 * i, out)
        write_vec3(wp.spatial_bottom(motion), at + 31 + 6 * i, out)
    for joint in range(count):
        out[at + 52 + joint] = actions[env, joint]


@configclass
class ReposeEnvCfg(DirectRLEnvCfg):
    """In-hand reorientation: 124 observations, 16 joint positions.

    An episode ends when the cube has fallen, or after 10 s.
    """

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 4
    episode_length_s: float = 10.0
    action_space: int = _JOINTS
    observation_space: int = 124
    sim: SimulationCfg = SimulationCfg(
        dt=1.0 / 120.0,
        render_interval=4,
        physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0),
        solver=MuJoCoSolverCfg(iterations=20, ls_iterations=20, nconmax=80, njmax=320),
    )
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=4096, env_spacing=0.75)
    viewer: ViewerCfg = ViewerCfg(eye=(0.35, -0.4, 0.85), lookat=(0.03, 0.0, 0.53))
    robot: ArticulationCfg = MISSING
    """The hand; found by its name where the config is made."""
    object: RigidObjectCfg = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Object",
        spawn=CuboidCfg(
            size=(SIZE, SIZE, SIZE),
            rigid_props=RigidBodyPropertiesCfg(),
            collision_props=CollisionPropertiesCfg(),
            mass_props=MassPropertiesCfg(density=400.0),
            physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0),
            visual_material=PreviewSurfaceCfg(diffuse_color=(0.1, 0.35, 0.75)),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.02, 0.0, 0.575)),
    )
    goal: RigidObjectCfg = goal_marker("frame", 0.06)
    marker_pos: tuple[float, float, float] = (0.02, 0.0, 0.7)
    """Place of the marker that shows the goal, in the environment's frame [m]."""
    in_hand_pos: tuple[float, float, float] = (0.02, 0.0, 0.55)
    """Place of the cube in the hand, in the environment's frame [m]."""
    reset_position_noise: float = 0.01
    """Largest shift of the cube at the start along each axis [m]."""
    reset_dof_pos_noise: float = 0.2
    """Share of the way to their limits by which joints start away from the default pose."""
    dist_reward_scale: float = -10.0
    """Weight of the distance of the cube from its place [1/m]."""
    rot_reward_scale: float = 1.0
    """Weight of the nearness of the orientation."""
    rot_eps: float = 0.1
    """Angle that is added to the cube's, so that the nearness stays finite [rad]."""
    action_penalty_scale: float = -0.0002
    """Weight of the squared actions."""
    reach_goal_bonus: float = 250.0
    """Reward for reaching a goal."""
    fall_penalty: float = 0.0
    """Reward for dropping the cube."""
    fall_dist: float = 0.24
    """Distance from its place at which the cube has fallen [m]."""
    vel_obs_scale: float = 0.2
    """Factor on angular velocities in observations."""
    success_tolerance: float = 0.2
    """Angle within which a goal is reached [rad]."""
    act_moving_average: float = 1.0
    """Share of the action in a new target; the rest is the target before."""

    def __post_init__(self) -> None:
        if self.robot is MISSING:
            self.robot = allegro_cfg().replace(prim_path="{ENV_REGEX_NS}/Robot")


class ReposeEnv(GoalMarked, DirectRLEnv):
    """Turn a cube in the hand to one goal after the other.

    Observations: joint positions within their limits and velocities, the cube's position, orientation and velocity, its
    place, the goal and the turn from it, positions, orientations and velocities of the fingertips, the last actions.
    """

    cfg: ReposeEnvCfg

    def __init__(self, cfg: ReposeEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        goals, array = Goals(), self.context.array
        numbers: Any = Numbers()
        for name in numbers._cls.vars:
            value = getattr(self.cfg, name)
            setattr(numbers, name, wp.vec3(*value) if isinstance(value, (tuple, list)) else value)
        # Arrays of the context are saved with a checkpoint.
        goals.rot, goals.marker = array("goal.rot", wp.quat), array("goal.marker", wp.transform)
        goals.successes = array("goal.successes", float)
        self._numbers, self._goal = numbers, goals
        self._actions = array("actions.last", float, _JOINTS)
        self._tips = wp.array(self.robot.find_bodies(TIPS, preserve_order=True)[0], dtype=int, device=self.device)
        self._log_successes = self.warp.log.add("Metrics/consecutive_successes", "mean")

    def _setup_scene(self) -> None:
        self.robot, self.object = Articulation(self.cfg.robot), RigidObject(self.cfg.object)
        self.scene.articulations["robot"] = self.robot
        self.scene.rigid_objects["object"] = self.object
        self.scene.rigid_objects["goal"] = RigidObject(self.cfg.goal)
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _goals(self) -> tuple[wp.array, wp.array]:
        return origin_frames(self.scene), self._goal.marker

    def _launch(self, kernel: wp.Kernel, *arguments: Any, dim: int | tuple[int, int] | None = None) -> None:
        wp.launch(kernel, dim=dim or self.num_envs, inputs=arguments, device=self.device)

    def _launch_pre_physics_step(self, actions: wp.array2d[float]) -> None:
        robot, size = self.robot.data.struct, (self.num_envs, _JOINTS)
        self._launch(set_targets, actions, self._actions, robot, self._numbers, dim=size)

    def _launch_dones(self) -> None:
        w, cube = self.warp, self.object.data.struct
        self._launch(compute_dones, cube, w.episode, self._numbers, w.terminated, w.truncated)

    def _launch_rewards(self) -> None:
        w, cube = self.warp, self.object.data.struct
        self._launch(compute_rewards, cube, self._actions, self._goal, w.rng, self._numbers, w.reward)

    def _launch_reset(self, env_mask: wp.array[wp.bool]) -> None:
        w, state = self.warp, (self.robot.data.struct, self.object.data.struct)
        log = w.log.sums, w.log.counts, self._log_successes
        self._launch(reset_envs, env_mask, *state, w.episode, self._goal, w.rng, self._numbers, *log)

    def _launch_observations(self) -> None:
        state = self.robot.data.struct, self.object.data.struct
        out = self.warp.observations["policy"]
        self._launch(compute_observations, *state, self._tips, self._actions, self._goal, self._numbers, out)


@configclass
class ReposePPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for in-hand reorientation."""

    num_steps_per_env: int = 16
    max_iterations: int = 5000
    save_interval: int = 250
    experiment_name: str = "repose_cube_allegro"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(1024, 512, 256, 128),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(1024, 512, 256, 128), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.005, learning_rate=5.0e-4, desired_kl=0.016)
