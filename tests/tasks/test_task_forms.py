# SPDX-License-Identifier: Apache-2.0
"""Task forms: cart-pole, ant and humanoid do the same in direct torch, direct Warp and manager-based form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gymnasium
import pytest
import torch
import warp as wp
from scipy import stats

import stripe_tasks  # noqa: F401
from stripe_kernels.data import ActionData, EpisodeData
from stripe_newton.configclass import resolve_name
from stripe_tasks.cartpole import direct_warp as cartpole_warp
from stripe_tasks.locomotion import direct_warp as locomotion_warp
from tests.helpers.small_tasks import small_cfg

N = 16
FORMS = {"torch": "Stripe-{}-Direct-v0", "warp": "Stripe-{}-Direct-Warp-v0", "manager": "Stripe-{}-v0"}
OTHERS = "warp", "manager"
RUNNERS = ["Ant", "Humanoid"]
ROBOTS = ["Cartpole", *RUNNERS]
ATOL = {"Cartpole": 2e-6, "Ant": 2e-5, "Humanoid": 2e-5}


@dataclass
class State:
    """State on which a step depends, and its actions."""

    joint_pos: torch.Tensor
    joint_vel: torch.Tensor
    root_pose: torch.Tensor
    root_vel: torch.Tensor
    last_pos: torch.Tensor
    length: torch.Tensor
    actions: torch.Tensor


def make(task: str, num_envs: int = N) -> Any:
    return gymnasium.make_vec(task, cfg=small_cfg(task, num_envs, seed=None))


@pytest.fixture(scope="module")
def forms():
    made: dict[str, Any] = {}

    def get(robot: str, *names: str) -> dict[str, Any]:
        found = {}
        for name in names or FORMS:
            task = FORMS[name].format(robot)
            env = made[task] if task in made else made.setdefault(task, make(task))
            env.reset(seed=3)
            found[name] = env
        return found

    yield get
    for env in made.values():
        env.close()


def random_state(env: Any, seed: int) -> State:
    """Robots in the air, turned any way and some of them too low; poles that have fallen or not; some at their time."""
    generator = torch.Generator().manual_seed(seed)

    def u(*shape: int) -> torch.Tensor:
        return 2.0 * torch.rand(*shape, generator=generator) - 1.0

    data, joints = env.scene["robot"].data, env.scene["robot"].num_joints
    lower, upper = data.soft_joint_pos_limits.unbind(-1)
    bounded = (upper - lower) < 1e3
    pos = torch.where(bounded, lower + (upper - lower) * (0.5 + 0.55 * u(N, joints)), 2.0 * u(N, joints))
    pose = data.root_pose_w.clone()
    length = torch.randint(1, env.max_episode_length - 1, (N,), generator=generator)
    length[::4] = env.max_episode_length - 1  # the step that comes is their last
    if joints > 2:
        pose[:, :3] = env.scene.env_origins + 3.0 * u(N, 3) + torch.tensor([0.0, 0.0, 5.0])
        pose[:, 3:] = torch.nn.functional.normalize(torch.randn(N, 4, generator=generator), dim=-1)
        pose[0, 3:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
        pose[1, 3:] = torch.tensor([0.0, 0.0, 1.0, 0.0])  # faces backwards
        low = slice(3, None, 5)  # upside down
        pose[low, 2], pos[low] = env.cfg.termination_height - 0.05, data.default_joint_pos[low]
        pose[low, 3:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    last_pos = pose[:, :2] + 0.05 * u(N, 2)
    actions = u(N, env.single_action_space.shape[0]) * (1.5 if joints > 2 else 0.5)
    return State(pos, 5.0 * u(N, joints), pose, 3.0 * u(N, 6), last_pos, length, actions)


def last_positions(env: Any) -> torch.Tensor | None:
    """Array in which a form keeps the positions of the last step; the same memory."""
    if hasattr(env, "reward_manager"):
        array = env.context.arrays.get("state.last_root_pos")
    else:
        array = getattr(env, "_last_pos", None)
    return wp.to_torch(array) if isinstance(array, wp.array) else array


def put(env: Any, state: State) -> None:
    data = env.scene["robot"].data
    data.joint_pos[:], data.joint_vel[:] = state.joint_pos, state.joint_vel
    if env.scene["robot"].num_joints > 2:
        data.root_pose_w[:], data.root_vel_w[:] = state.root_pose, state.root_vel
        last_positions(env)[:] = state.last_pos
    env.episode_length_buf = state.length
    env.sim.forward()


# -- the kernels of the direct Warp form, launched alone


def episode_of(env: Any) -> EpisodeData:
    episode = EpisodeData()
    episode.length = wp.from_torch(env.episode_length_buf)
    episode.terminated, episode.truncated = wp.zeros(N, dtype=wp.bool), wp.zeros(N, dtype=wp.bool)
    episode.max_length, episode.step_dt = env.max_episode_length, env.step_dt
    return episode


def launch(kernel: wp.Kernel, *arguments: Any) -> None:
    wp.launch(kernel, dim=N, inputs=arguments, device="cpu")


def outcome(env: Any) -> tuple[torch.Tensor, ...]:
    """Terminated, truncated, rewards and observations by the torch hooks."""
    terminated, truncated = env._get_dones()
    env.reset_terminated[:] = terminated
    env.extras["log"] = {}
    rewards = env._get_rewards()
    return terminated, truncated, rewards, env._get_observations()["policy"]


def assert_same(got: tuple[Any, ...], expected: tuple[torch.Tensor, ...]) -> None:
    for one, two in zip(got, expected, strict=True):
        torch.testing.assert_close(wp.to_torch(one), two, atol=2e-6, rtol=2e-6)


@pytest.mark.parametrize("seed", range(3))
def test_kernels_of_cartpole(forms, seed):
    env = forms("Cartpole", "torch")["torch"]
    state = random_state(env, seed)
    state.length += 1
    put(env, state)
    expected = outcome(env)
    assert 0 < expected[0].sum() < N
    cfg, robot, episode, ids = env.cfg, env.robot.data.struct, episode_of(env), (env._cart, env._pole)
    reward, out = wp.zeros(N, dtype=float), wp.zeros((N, 4), dtype=float)
    ends = episode.terminated, episode.truncated
    launch(cartpole_warp.compute_dones, robot, episode, *ids, cfg.max_cart_pos, *ends)
    weights = cfg.rew_alive, cfg.rew_terminated, cfg.rew_pole_pos, cfg.rew_cart_vel, cfg.rew_pole_vel
    launch(cartpole_warp.compute_rewards, robot, episode, *ids, *weights, reward)
    launch(cartpole_warp.compute_observations, robot, *ids, out)
    assert_same((*ends, reward, out), expected)


@pytest.mark.parametrize("robot", RUNNERS)
def test_kernels_of_runners(forms, robot):
    env = forms(robot, "torch")["torch"]
    kernels, joints = locomotion_warp, env.robot.num_joints
    for seed in range(3):
        state = random_state(env, seed)
        state.length += 1
        put(env, state)
        env.actions = state.actions.clamp(-1.0, 1.0)
        expected = outcome(env)
        assert 0 < expected[0].sum() < N
        data, episode, numbers = env.robot.data.struct, episode_of(env), kernels.numbers_of(env.cfg)
        actions = wp.from_torch(state.actions)
        inputs = [actions, wp.from_torch(env._efforts), data]
        wp.launch(kernels.set_efforts, dim=(N, joints), inputs=inputs, device="cpu")
        torch.testing.assert_close(env.robot.data.joint_effort_target, env._efforts * env.actions)
        given, ids = ActionData(), wp.array(list(range(joints)), dtype=int)
        given.action = actions
        last_pos = wp.from_torch(state.last_pos.clone(), dtype=wp.vec2)
        ends = episode.terminated, episode.truncated
        reward, out = wp.zeros(N, dtype=float), wp.zeros((N, 12 + 3 * joints), dtype=float)
        sums, counts = wp.zeros(2, dtype=float), wp.zeros(2, dtype=int)
        launch(kernels.compute_dones, data, episode, numbers, *ends)
        ratio = wp.from_torch(env._gear_ratio)
        log = sums, counts, 1
        launch(kernels.compute_rewards, data, given, episode, numbers, ids, ratio, last_pos, *log, reward)
        launch(kernels.compute_observations, data, given, numbers, ids, out)
        assert_same((*ends, reward, out), expected)
        assert torch.equal(wp.to_torch(last_pos), env.robot.data.root_pos_w[:, :2])
        assert counts.numpy().tolist() == [0, N]


# -- the three forms


@pytest.mark.parametrize("robot", ROBOTS)
def test_same_steps_from_the_same_state(forms, robot):
    """One in which some fall and some run out of time, and the one after it."""
    envs = forms(robot)
    for seed in range(3):
        state = random_state(envs["torch"], seed)
        results, logs = {}, {}
        for name, env in envs.items():
            env.reset(seed=seed)
            put(env, state)
            steps = [env.step(state.actions.clone()), env.step(-0.5 * state.actions)]
            results[name] = [(s[0]["policy"], *s[1:4]) for s in steps]
            logs[name] = steps[0][4]["log"]
        _, _, terminated, truncated = results["torch"][0]
        assert 0 < terminated.sum() < N
        assert 0 < truncated.sum() < N
        same = ~(terminated | truncated) if robot == "Cartpole" else torch.ones(N, dtype=torch.bool)
        for name in OTHERS:
            for index, (one, two) in enumerate(zip(results[name], results["torch"], strict=True)):
                rows = torch.ones(N, dtype=torch.bool) if index == 0 else same
                torch.testing.assert_close(one[0][same], two[0][same], atol=ATOL[robot], rtol=1e-5)
                torch.testing.assert_close(one[1][rows], two[1][rows], atol=ATOL[robot], rtol=1e-5)
                assert torch.equal(one[2][rows], two[2][rows]), name
                assert torch.equal(one[3][rows], two[3][rows]), name
            if robot != "Cartpole":
                assert math.isfinite(float(logs[name]["Episode_Reward/progress"]))


@pytest.mark.parametrize("robot", ROBOTS)
def test_same_steps_from_the_start(forms, robot):
    """Ten steps from a state in the air, without ends."""
    envs = forms(robot)
    state = random_state(envs["torch"], 0)
    state.length[:] = 1
    if robot == "Cartpole":
        state.joint_pos *= 0.2
        state.joint_vel *= 0.1
    else:
        state.root_pose[:, 2] = 8.0
        state.root_vel[:] = 0.0
    generator = torch.Generator().manual_seed(0)
    actions = [torch.rand(state.actions.shape, generator=generator) - 0.5 for _ in range(10)]
    traces = {}
    for name, env in envs.items():
        env.reset(seed=0)
        put(env, state)
        steps = [env.step(0.4 * action) for action in actions]
        assert not any((s[2] | s[3]).any() for s in steps)
        traces[name] = [(s[0]["policy"], s[1]) for s in steps]
    for name in OTHERS:
        for (obs, reward), (expected, its_reward) in zip(traces[name], traces["torch"], strict=True):
            torch.testing.assert_close(obs, expected, atol=1e-3, rtol=1e-3)
            torch.testing.assert_close(reward, its_reward, atol=1e-3, rtol=1e-3)


def test_start_of_cartpole(forms):
    """The pole's first angle is uniform, in all three forms, and all else at rest."""
    for name, env in forms("Cartpole").items():
        obs = torch.cat([env.reset(seed=s)[0]["policy"] for s in range(40)])
        limit = math.pi / 4
        assert obs[:, 0].abs().max() <= limit, name
        assert (obs[:, 1:] == 0.0).all(), name
        p = stats.kstest(obs[:, 0].double().numpy(), stats.uniform(-limit, 2 * limit).cdf).pvalue
        assert p > 1e-3, f"{name}: {p}"


def test_resets_within_steps_of_cartpole(forms):
    """Environments that ended go on from new random angles, the others undisturbed."""
    for name, env in forms("Cartpole").items():
        starts = []
        for seed in range(8):
            state = random_state(env, seed)
            env.reset(seed=seed)
            put(env, state)
            obs, _, terminated, truncated, _ = env.step(state.actions.clone())
            starts.append(obs["policy"][terminated | truncated])
        starts = torch.cat(starts)
        assert len(starts) > 40, name
        assert (starts[:, 1:] == 0.0).all(), name
        assert starts[:, 0].abs().max() <= math.pi / 4, name
        assert len(starts[:, 0].unique()) > 0.95 * len(starts), name


@pytest.mark.parametrize("robot", RUNNERS)
def test_start_of_runners(forms, robot):
    envs = forms(robot)
    first = {name: env.reset(seed=0)[0]["policy"] for name, env in envs.items()}
    for name in OTHERS:
        torch.testing.assert_close(first[name], first["torch"], atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize("form", OTHERS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_state_goes_on_where_it_stopped(forms, robot, form):
    """What the forms keep beside the simulation is saved too: in an environment that has taken no step yet."""
    env = forms(robot, form)[form]
    generator = torch.Generator().manual_seed(0)
    shape = (N, env.single_action_space.shape[0])
    actions = [0.3 * (2.0 * torch.rand(shape, generator=generator) - 1.0) for _ in range(6)]
    for action in actions[:3]:
        env.step(action)
    saved = env.get_state()
    expected = [env.step(action)[:2] for action in actions[3:]]
    other = make(FORMS[form].format(robot))
    other.set_state(saved)
    for action, (obs, reward) in zip(actions[3:], expected, strict=True):
        got = other.step(action)
        torch.testing.assert_close(got[0]["policy"], obs["policy"], atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(got[1], reward, atol=2e-3, rtol=1e-3)
    other.close()


@pytest.mark.parametrize("robot", ROBOTS)
def test_configs_of_the_forms_agree(robot):
    kwargs = {form: gymnasium.spec(task.format(robot)).kwargs for form, task in FORMS.items()}
    cfgs = {form: resolve_name(k["env_cfg_entry_point"])() for form, k in kwargs.items()}
    for cfg in cfgs.values():
        cfg.validate()
    for name in ("decimation", "episode_length_s", "sim"):
        assert getattr(cfgs["manager"], name) == getattr(cfgs["torch"], name), name
    assert cfgs["manager"].scene.robot == cfgs["torch"].robot
    folders = {resolve_name(k["rsl_rl_cfg_entry_point"])().experiment_name for k in kwargs.values()}
    assert len(folders) == 3
