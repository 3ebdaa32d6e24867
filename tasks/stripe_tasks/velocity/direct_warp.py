# SPDX-License-Identifier: Apache-2.0
"""Direct velocity tasks in Warp: base of ``Stripe-Velocity-Flat-*-Direct-Warp-v0``.

Observations, rewards and dones are those of the manager-based tasks in :mod:`stripe_tasks.velocity.quadruped` and
:mod:`stripe_tasks.velocity.humanoid`. Each hook is one kernel; a task is a config and a kernel of rewards.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import ActionData, ArticulationData, CommandData, EpisodeData, VelocityCommandData
from stripe_kernels.episode import log_add
from stripe_kernels.mdp import random
from stripe_kernels.sensors.contact import ContactSensorData
from stripe_kernels.terrain import TerrainData
from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sensors import ContactSensor, ContactSensorCfg
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robot_scene import spawn_scenery

from .manager_based import VelocityEnvCfg

__all__ = ["VelocityTask", "VelocityWarpEnv", "VelocityWarpEnvCfg", "earn"]

Range = tuple[float, float]


@configclass
class VelocityWarpEnvCfg(DirectRLEnvCfg):
    """Numbers of a direct velocity task; bodies and joints are named by expressions."""

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "observation_space")

    decimation: int = 4
    episode_length_s: float = 20.0
    sim: SimulationCfg = VelocityEnvCfg().sim
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=4096, env_spacing=2.5)
    robot: ArticulationCfg = MISSING
    """The robot."""
    contact_forces: ContactSensorCfg = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_air_time=True)
    """Contact sensor on all bodies."""
    feet: str = MISSING
    """Bodies that the robot walks on."""
    fallen: str = MISSING
    """Bodies whose contact with the ground is a fall."""
    action_scale: float = 0.25
    """Change of a joint's position target for an action of one [rad]."""
    lin_vel_x: Range = (-1.0, 1.0)
    """Bounds of the commanded forward velocity [m/s]."""
    lin_vel_y: Range = (-1.0, 1.0)
    """Bounds of the commanded sideways velocity [m/s]."""
    ang_vel_z: Range = (-1.0, 1.0)
    """Bounds of the commanded yaw rate [rad/s]."""
    rel_standing_envs: float = 0.05
    """Share of commands to stand still."""
    heading_control_stiffness: float = 0.5
    """Commanded yaw rate per error of the heading [1/s]."""
    resampling_time_range: Range = (10.0, 10.0)
    """Time until a new command is drawn [s]."""
    push_interval_s: Range = (10.0, 15.0)
    """Time between two pushes [s]."""
    push_velocity: float = 0.5
    """Largest change of the velocity along x and y by a push [m/s]."""
    weights: dict[str, float] = MISSING
    """Weights of the rewards by term, per second; the task's kernel names the terms."""


@wp.struct
class VelocityTask:
    """Numbers, indices and state that the kernels of these tasks share."""

    lin_vel_x: wp.vec2
    lin_vel_y: wp.vec2
    ang_vel_z: wp.vec2
    heading: wp.vec2
    rel_standing_envs: float
    heading_control_stiffness: float
    resampling_time_range: wp.vec2
    push_interval_s: wp.vec2
    action_scale: float
    step_dt: float
    max_length_s: float
    first_log: int
    joint_ids: wp.array[int]
    feet: wp.array[int]
    """Indices into the bodies of the sensor."""
    fallen: wp.array[int]
    """Indices into the bodies of the sensor."""
    foot_bodies: wp.array[int]
    """Indices into the bodies of the robot."""
    weights: wp.array[float]
    push_velocity: wp.array[wp.vec2]
    pose_range: wp.array[wp.vec2]
    at_rest: wp.array[wp.vec2]
    log_sums: wp.array[float]
    log_counts: wp.array[int]
    clock: CommandData
    command: VelocityCommandData
    push_time_left: wp.array[float]
    rng: wp.array[wp.uint32]


@wp.kernel(enable_backward=False)
def set_targets(asked: wp.array2d[float], actions: ActionData, task: VelocityTask, robot: ArticulationData) -> None:
    """Set position targets for the actions; one thread for each joint."""
    env, joint = wp.tid()
    actions.prev_action[env, joint] = actions.action[env, joint]
    actions.action[env, joint] = asked[env, joint]
    target = robot.default_joint_pos[env, joint] + task.action_scale * asked[env, joint]
    robot.joint_pos_target[env, joint] = target


@wp.kernel(enable_backward=False)
def compute_dones(
    sensor: ContactSensorData,
    task: VelocityTask,
    episode: EpisodeData,
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
) -> None:
    """End an episode with a fall, or after its full length."""
    env = wp.tid()
    terminated[env] = mdp.illegal_contact(env, sensor, task.fallen, 1.0)
    truncated[env] = mdp.time_out(env, episode)


@wp.func
def earn(
    env: int, term: int, value: float, task: VelocityTask, sums: wp.array2d[float], reward: wp.array[float]
) -> None:
    """Add a weighted term to the reward, and to its sum over the episode."""
    weighted = task.weights[term] * value
    sums[env, term] = sums[env, term] + weighted
    reward[env] = reward[env] + weighted


@wp.func
def new_command(env: int, task: VelocityTask) -> None:
    """Draw a command."""
    mdp.resample_uniform_velocity(
        env,
        task.command,
        task.rng,
        task.lin_vel_x,
        task.lin_vel_y,
        task.ang_vel_z,
        task.heading,
        1.0,
        task.rel_standing_envs,
    )


@wp.kernel(enable_backward=False)
def reset_envs(
    mask: wp.array[wp.bool], robot: ArticulationData, actions: ActionData, task: VelocityTask, sums: wp.array2d[float]
) -> None:
    """Start an episode: a pose near the origin in any direction, a command, no past actions; log the reward sums."""
    env = wp.tid()
    if not mask[env]:
        return
    mdp.reset_root_state_uniform(env, robot, task.rng, task.pose_range, task.at_rest)
    mdp.reset_joints_by_scale(env, robot, task.rng, task.joint_ids, wp.vec2(0.9, 1.1), wp.vec2(0.0, 0.0))
    mdp.reset_joint_targets_to_default(env, robot)
    mdp.restart_command(env, task.clock, task.rng, task.resampling_time_range)
    new_command(env, task)
    task.push_time_left[env] = random.uniform_range(env, task.rng, task.push_interval_s)
    for i in range(actions.action.shape[1]):
        actions.action[env, i] = 0.0
        actions.prev_action[env, i] = 0.0
    for i in range(sums.shape[1]):
        log_add(task.log_sums, task.log_counts, task.first_log + i, sums[env, i] / task.max_length_s)
        sums[env, i] = 0.0


@wp.func
def noisy(env: int, task: VelocityTask, bound: float, values: wp.array[float]) -> None:
    """Add uniform noise of either sign."""
    for i in range(values.shape[0]):
        values[i] = values[i] + random.uniform_range(env, task.rng, wp.vec2(-bound, bound))


@wp.func
def observe(
    env: int, robot: ArticulationData, actions: ActionData, task: VelocityTask, noise: float, out: wp.array[float]
) -> None:
    """Write base velocities, gravity, command, joints, actions.

    ``noise`` scales the noise of the manager-based form: 1 for the policy, 0 for the critic.
    """
    joints = task.joint_ids.shape[0]
    velocities = 12 + joints
    mdp.base_lin_vel(env, robot, out[0:3])
    mdp.base_ang_vel(env, robot, out[3:6])
    mdp.projected_gravity(env, robot, out[6:9])
    mdp.generated_commands(env, task.clock, out[9:12])
    mdp.joint_pos_rel(env, robot, task.joint_ids, out[12:velocities])
    mdp.joint_vel_rel(env, robot, task.joint_ids, out[velocities : velocities + joints])
    mdp.last_action(env, actions, out[velocities + joints : velocities + 2 * joints])
    if noise > 0.0:
        noisy(env, task, 0.1 * noise, out[0:3])
        noisy(env, task, 0.2 * noise, out[3:6])
        noisy(env, task, 0.05 * noise, out[6:9])
        noisy(env, task, 0.01 * noise, out[12:velocities])
        noisy(env, task, 1.5 * noise, out[velocities : velocities + joints])


@wp.kernel(enable_backward=False)
def compute_observations(
    robot: ArticulationData,
    actions: ActionData,
    task: VelocityTask,
    policy: wp.array2d[float],
    critic: wp.array2d[float],
) -> None:
    """Do pushes and draw commands that are due, then write the observations of policy and critic.

    Pushes come first and commands second, as in a manager-based step: observations show their results.
    """
    env = wp.tid()
    left = task.push_time_left[env] - task.step_dt
    if left <= 0.0:
        mdp.push_by_setting_velocity(env, robot, task.rng, task.push_velocity)
        left = random.uniform_range(env, task.rng, task.push_interval_s)
    task.push_time_left[env] = left
    if mdp.advance_command(env, task.clock, task.rng, task.resampling_time_range, task.step_dt):
        new_command(env, task)
    mdp.update_uniform_velocity(env, task.command, robot, task.heading_control_stiffness, task.ang_vel_z)
    observe(env, robot, actions, task, 1.0, policy[env])
    observe(env, robot, actions, task, 0.0, critic[env])


@wp.kernel(enable_backward=False)
def end_outside(robot: ArticulationData, terrain: TerrainData, truncated: wp.array[wp.bool]) -> None:
    """End an episode outside of an imported scenery, or below it."""
    env = wp.tid()
    truncated[env] = truncated[env] or mdp.terrain_out_of_bounds(env, robot, terrain, 0.0)


class VelocityWarpEnv(DirectRLEnv):
    """Base of the direct velocity tasks; a task brings its kernel of rewards."""

    cfg: VelocityWarpEnvCfg
    reward_kernel: ClassVar[wp.Kernel]
    """Kernel of the rewards: ``(robot, actions, episode, sensor, task, sums, *groups, reward)``."""
    reward_terms: ClassVar[tuple[str, ...]]
    """Names of the terms, in the order of the sums."""

    def __init__(self, cfg: VelocityWarpEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        joints, array = self.robot.num_joints, self.context.array
        # arrays of the context are saved with a checkpoint
        self._actions: Any = ActionData()
        self._actions.action = array("velocity.action", float, joints)
        self._actions.prev_action = array("velocity.prev_action", float, joints)
        self._sums = array("velocity.reward_sums", float, len(self.reward_terms))
        self._task, self._groups = self._make_task(), self._reward_groups()

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        self.contact_forces = ContactSensor(self.cfg.contact_forces)
        self.scene.sensors["contact_forces"] = self.contact_forces
        spawn_scenery()
        self.scene.clone_environments(copy_from_source=False)

    def _reward_groups(self) -> list[wp.array]:
        """Indices of bodies and joints that the kernel of rewards takes as ``groups``."""
        raise NotImplementedError

    def _make_task(self) -> VelocityTask:
        """Fill the struct that the kernels share from the config."""
        cfg, task, array = self.cfg, VelocityTask(), self.context.array
        task.clock, task.command = CommandData(), VelocityCommandData()
        task.command.command = task.clock.command = array("velocity.command", float, 3)
        task.clock.time_left = array("velocity.command_time_left", float)
        task.clock.counter = array("velocity.command_counter", int)
        task.command.heading_target = array("velocity.heading_target", float)
        task.command.is_heading = array("velocity.is_heading", wp.bool)
        task.command.is_standing = array("velocity.is_standing", wp.bool)
        task.push_time_left = array("velocity.push_time_left", float, fill=cfg.push_interval_s[0])
        for name in ("lin_vel_x", "lin_vel_y", "ang_vel_z", "resampling_time_range", "push_interval_s"):
            setattr(task, name, wp.vec2(*getattr(cfg, name)))
        for name in ("rel_standing_envs", "heading_control_stiffness", "action_scale"):
            setattr(task, name, getattr(cfg, name))
        task.heading, task.step_dt, task.rng = wp.vec2(-math.pi, math.pi), self.step_dt, self.warp.rng
        # log entries are consecutive, so a kernel needs only the first one
        task.first_log = min(self.warp.log.add(f"Episode_Reward/{name}") for name in self.reward_terms)
        task.log_sums, task.log_counts = self.warp.log.sums, self.warp.log.counts
        task.max_length_s = cfg.episode_length_s
        # ranges by component: x, y, z, roll, pitch, yaw
        push, none, turn = (-cfg.push_velocity, cfg.push_velocity), (0.0, 0.0), (-math.pi, math.pi)
        near = none if self.scene.scenery is not None else (-0.5, 0.5)  # a scenery has room at its places alone
        with wp.ScopedDevice(self.device):
            task.joint_ids = wp.array(list(range(self.robot.num_joints)), dtype=int)
            task.feet = wp.array(self.contact_forces.find_bodies(cfg.feet)[0], dtype=int)
            task.fallen = wp.array(self.contact_forces.find_bodies(cfg.fallen)[0], dtype=int)
            task.foot_bodies = wp.array(self.robot.find_bodies(cfg.feet)[0], dtype=int)
            task.weights = wp.array([cfg.weights[n] * self.step_dt for n in self.reward_terms], dtype=float)
            task.push_velocity = wp.array([push, push, none, none, none, none], dtype=wp.vec2)
            task.pose_range = wp.array([near, near, none, none, none, turn], dtype=wp.vec2)
            task.at_rest = wp.zeros(6, dtype=wp.vec2)
        return task

    def _launch(self, kernel: wp.Kernel, *arguments: Any, columns: tuple[int, ...] = ()) -> None:
        wp.launch(kernel, dim=(self.num_envs, *columns), inputs=arguments, device=self.device)

    def _launch_pre_physics_step(self, actions: wp.array2d[float]) -> None:
        state = self._actions, self._task, self.robot.data.struct
        self._launch(set_targets, actions, *state, columns=actions.shape[1:])

    def _launch_dones(self) -> None:
        w = self.warp
        self._launch(compute_dones, self.contact_forces.struct, self._task, w.episode, w.terminated, w.truncated)
        if self.scene.scenery is not None and self.scene.terrain is not None:
            self._launch(end_outside, self.robot.data.struct, self.scene.terrain.struct, w.truncated)

    def _launch_rewards(self) -> None:
        state = self.robot.data.struct, self._actions, self.warp.episode, self.contact_forces.struct, self._task
        self._launch(type(self).reward_kernel, *state, self._sums, *self._groups, self.warp.reward)

    def _launch_reset(self, env_mask: wp.array[wp.bool]) -> None:
        self._launch(reset_envs, env_mask, self.robot.data.struct, self._actions, self._task, self._sums)

    def _launch_observations(self) -> None:
        groups = self.warp.observations
        state = self.robot.data.struct, self._actions, self._task
        self._launch(compute_observations, *state, groups["policy"], groups["critic"])
