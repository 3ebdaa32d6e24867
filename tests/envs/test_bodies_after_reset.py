# SPDX-License-Identifier: Apache-2.0
"""Bodies after a reset within the step: every reader gets those of the new episode, whatever kind of term it is."""

from __future__ import annotations

from typing import Any

import newton
import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData, CommandData
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import ActionTermCfg, CommandTermCfg, ObservationTermCfg, RewardTermCfg
from stripe_newton.sim.physics_hook import PhysicsHook
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.manager_world import observation_group

N = 4
STEPS = 5
"""Steps in an episode."""


@wp.func
def write_rotation(robot: ArticulationData, env: int, out: wp.array[float]):
    """Rotation of the last body, the pole."""
    rotation = wp.transform_get_rotation(robot.body_pose[env, robot.body_pose.shape[1] - 1])
    for k in range(4):
        out[k] = rotation[k]


@wp.func
def by_warp_term(env: int, robot: ArticulationData, out: wp.array[float]):
    write_rotation(robot, env, out)


def calling(helper: wp.Function) -> wp.Function:
    """A term that reaches its helper through a closure."""

    @wp.func
    def by_closure(env: int, robot: ArticulationData, out: wp.array[float]):
        helper(robot, env, out)

    return by_closure


def calling_static(helper: wp.Function) -> wp.Function:
    """A term whose helper is an expression that Warp evaluates when it compiles the term."""
    helpers = {"write": helper}

    @wp.func
    def by_static(env: int, robot: ArticulationData, out: wp.array[float]):
        wp.static(helpers["write"])(robot, env, out)

    return by_static


@wp.func_native("""
    const auto* pose = wp::address(robot.body_pose, env, robot.body_pose.shape[1] - 1);
    for (int k = 0; k < 4; ++k)
        out.data[k] = pose->q[k];
""")
def native_write(robot: ArticulationData, env: int, out: wp.array[float]): ...


@wp.func
def by_native(env: int, robot: ArticulationData, out: wp.array[float]):
    native_write(robot, env, out)


def by_torch(env: ManagerBasedRLEnv) -> torch.Tensor:
    return env.scene["robot"].data.body_quat_w[:, -1]


@wp.func
def by_joints(env: int, robot: ArticulationData, out: wp.array[float]):
    out[0] = robot.joint_pos[env, 0]


@wp.func
def mentions_bodies(env: int, robot: ArticulationData, out: wp.array[float]):
    """Reads no body, though it mentions robot.body_pose[env, 0] here."""
    out[0] = robot.joint_pos[env, 0]  # not robot.body_pose


@wp.func
def show_command(env: int, command: CommandData, out: wp.array[float]):
    for k in range(4):
        out[k] = command.command[env, k]


@wp.func
def command_rotation(env: int, command: CommandData, robot: ArticulationData):
    write_rotation(robot, env, command.command[env])


def make(device: str, terms: dict[str, ObservationTermCfg], **changes: Any) -> ManagerBasedRLEnv:
    cfg = CartpoleManagerEnvCfg(episode_length_s=STEPS / 60.0, seed=3).replace(**changes)
    cfg.sim.device, cfg.scene.num_envs = device, N
    cfg.observations = {"policy": observation_group({"cart": ObservationTermCfg(func=by_joints, size=1)} | terms)}
    return ManagerBasedRLEnv(cfg)


def end_episodes(env: ManagerBasedRLEnv) -> torch.Tensor:
    """Step until all episodes but one end in the same step; the observations of that step without the cart's."""
    env.reset(seed=1)
    env.episode_length_buf[1] = 2  # this one ends earlier than the others
    for _ in range(STEPS):
        obs, _, _, truncated, _ = env.step(torch.zeros(N, 1, device=env.device))
    assert truncated.tolist() == [True, False, True, True]
    return obs["policy"][:, 1:]


def rotation_of_joints(env: ManagerBasedRLEnv) -> torch.Tensor:
    """Rotation of the pole by Newton's forward kinematics, computed apart from the simulation's own bodies."""
    model = env.sim.model
    state = model.state()
    state.joint_q.assign(env.scene["robot"].data.joint_pos.flatten().cpu().numpy())
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    return wp.to_torch(state.body_q).view(N, -1, 7)[:, -1, 3:]


READERS = {
    "a Warp term": by_warp_term,
    "a helper in a closure": calling(write_rotation),
    "a helper in a static expression": calling_static(write_rotation),
    "native code": by_native,
    "a torch term": by_torch,
}


@pytest.mark.parametrize("func", READERS.values(), ids=READERS.keys())
def test_observations_show_the_bodies_of_the_new_episode(device, func):
    env = make(device, {"rotation": ObservationTermCfg(func=func, size=4)})
    seen = end_episodes(env)
    torch.testing.assert_close(seen, rotation_of_joints(env), rtol=0.0, atol=1e-6)


def test_a_command_that_reads_bodies_gets_those_of_the_new_episode(device):
    command = CommandTermCfg(
        resampling_time_range=(9.0, 9.0), resample=command_rotation, update=command_rotation, size=4
    )
    shown = ObservationTermCfg(func=show_command, size=4, params={"command_name": "rotation"})
    env = make(device, {"command": shown}, commands={"rotation": command})
    seen = end_episodes(env)
    torch.testing.assert_close(seen, rotation_of_joints(env), rtol=0.0, atol=1e-6)


@wp.func
def act_by_rotation(env: int, action: wp.array[float], robot: ArticulationData, processed: wp.array[float]):
    write_rotation(robot, env, processed)


@wp.func
def do_nothing(env: int, processed: wp.array[float]):
    pass


def test_actions_that_read_bodies_get_those_of_the_new_episode(device):
    """They are the first to read them in the next step, before its physics computes bodies anew."""
    act = ActionTermCfg(process=act_by_rotation, apply=do_nothing, per_substep=False, action_size=1, processed_size=4)
    env = make(device, {}, actions={"rotation": act})
    end_episodes(env)
    before = rotation_of_joints(env)
    env.step(torch.zeros(N, 1, device=env.device))
    torch.testing.assert_close(env.processed_actions, before, rtol=0.0, atol=1e-6)


def test_a_mention_in_a_comment_is_no_read(device):
    """Then forward kinematics waits until somebody asks for the bodies."""
    env = make(device, {"mention": ObservationTermCfg(func=mentions_bodies, size=1)})
    assert "forward kinematics" not in [what for _, what, _ in env.plan.rows()]
    end_episodes(env)
    torch.testing.assert_close(env.scene["robot"].data.body_quat_w[:, -1], rotation_of_joints(env), rtol=0.0, atol=1e-6)


@wp.func
def by_pole(env: int, robot: ArticulationData) -> float:
    return wp.transform_get_rotation(robot.body_pose[env, robot.body_pose.shape[1] - 1])[3]


@wp.func
def by_cart(env: int, robot: ArticulationData) -> float:
    return robot.joint_pos[env, 0]


@pytest.mark.parametrize("reads", [False, True])
def test_bodies_of_every_step_are_there_whether_or_not_a_reward_reads_them(device, reads):
    """If none of the step reads them, the physics leaves them to who asks."""
    rewards = {"own": RewardTermCfg(func=by_pole if reads else by_cart, weight=1.0)}
    env = make(device, {}, rewards=rewards)
    env.reset(seed=1)
    kept = wp.to_torch(env.sim.state.body_q)
    for _ in range(STEPS - 2):
        env.step(torch.ones(N, 1, device=env.device))
    untouched = kept.clone()
    rotation = env.scene["robot"].data.body_quat_w[:, -1]
    assert torch.equal(kept, untouched) == reads  # a view that was taken before shows them once somebody asked
    torch.testing.assert_close(rotation, rotation_of_joints(env), rtol=0.0, atol=1e-6)
    if reads:
        reward = env.reward_manager.step_reward[:, 0]
        torch.testing.assert_close(reward, rotation[:, 3], rtol=0.0, atol=1e-6)


def test_a_hook_of_the_physics_that_is_added_later_finds_the_bodies(device):
    class Keep(PhysicsHook):
        def launch_after_step(self) -> None:
            wp.copy(kept, bodies)

    env = make(device, {})
    env.reset(seed=1)
    bodies = env.sim.state.body_q
    kept = wp.zeros_like(bodies)
    env.step(torch.ones(N, 1, device=env.device))  # leaves the bodies
    env.sim.add_hook(Keep())
    env.step(torch.ones(N, 1, device=env.device))
    pole = wp.to_torch(kept).view(N, -1, 7)[:, -1, 3:]
    torch.testing.assert_close(pole, rotation_of_joints(env), rtol=0.0, atol=1e-6)
