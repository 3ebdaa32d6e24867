# SPDX-License-Identifier: Apache-2.0
"""DirectRLEnv: its contract with hooks and learners, and known traps."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg, EventTermCfg, to_space
from stripe_newton.noise import ConstantNoiseCfg, NoiseModelCfg, NoiseModelWithAdditiveBiasCfg, UniformNoiseCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.cart_env import CartCfg, CartEnv, N, make, zeros


@pytest.fixture
def env():
    env = make()
    env.reset(seed=3)
    return env


# -- surface


def test_surface(env):
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert (env.num_envs, env.device, env.physics_dt, env.step_dt) == (N, "cpu", 0.01, 0.02)
    assert (env.max_episode_length, env.max_episode_length_s) == (10, 0.2)
    assert env.single_observation_space["policy"].shape == (4,)
    assert env.observation_space["policy"].shape == (N, 4)
    assert env.single_action_space.shape == (1,)
    assert env.action_space.shape == (N, 1)
    for name, dtype in (
        ("episode_length_buf", torch.int64),
        ("reset_buf", torch.bool),
        ("reset_terminated", torch.bool),
        ("reset_time_outs", torch.bool),
    ):
        assert (getattr(env, name).shape, getattr(env, name).dtype) == ((N,), dtype), name
    assert env.unwrapped is env
    assert env.cfg is not None
    assert env.scene.num_envs == N
    assert env.sim.num_envs == N
    assert env.set_debug_vis(True) is False
    assert env.state_space is None
    hooks = "_setup_scene _pre_physics_step _apply_action _get_observations _get_states _get_rewards _get_dones"
    for name in f"{hooks} _reset_idx _set_debug_vis_impl seed reset step render close".split():
        assert callable(getattr(env, name)), name


def test_fields_of_the_config():
    names = DirectRLEnvCfg.__dataclass_fields__
    wanted = """viewer sim seed decimation episode_length_s scene observation_space action_space state_space events
        is_finite_horizon observation_noise_model action_noise_model rerender_on_reset compute_final_obs"""
    for name in wanted.split():
        assert name in names, name


@pytest.mark.parametrize(
    ("seconds", "dt", "decimation", "steps"),
    [(5.0, 1 / 120, 2, 300), (0.2, 0.01, 3, 7), (1.0, 0.1, 1, 10), (0.21, 0.1, 1, 3)],
)
def test_max_episode_length(seconds, dt, decimation, steps):
    cfg = CartCfg().replace(episode_length_s=seconds, decimation=decimation)
    cfg.sim.dt = dt
    assert CartEnv(cfg).max_episode_length == steps


def test_values_of_a_step(env):
    obs, reward, terminated, truncated, extras = env.step(zeros(env))
    assert set(obs) == {"policy"}
    assert (obs["policy"].shape, obs["policy"].dtype) == ((N, 4), torch.float32)
    assert (reward.shape, reward.dtype) == ((N,), torch.float32)
    assert (terminated.dtype, truncated.dtype) == (torch.bool, torch.bool)
    assert isinstance(extras["log"], dict)
    assert env.common_step_counter == 1
    assert env.episode_length_buf.tolist() == [1] * N


# -- order


def test_order_of_a_step():
    env = make(apply_action="step")
    env.reset()
    env.fail[1] = True
    env.calls.clear()
    env.step(zeros(env))
    assert env.calls == ["pre", "apply", "dones", "rewards", "reset", "observations"]
    env.fail[1] = False
    env.calls.clear()
    env.step(zeros(env))
    assert env.calls == ["pre", "apply", "dones", "rewards", "observations"]


def test_order_with_substeps_states_events_and_final_observation():
    calls: list[str] = []

    class Env(CartEnv):
        def _reset_events(self, ids):
            calls.append("reset events")
            super()._reset_events(ids)

        def _interval_events(self, dt):
            self.calls.append("interval")
            assert dt == self.step_dt

        def _get_states(self):
            self.calls.append("states")
            return torch.ones(self.num_envs, 3)

    env = make(Env, apply_action="substep", state_space=3, compute_final_obs=True)
    env.reset()
    env.fail[0] = True
    env.calls.clear()
    obs, *_ = env.step(zeros(env))
    observe = ["observations", "states"]
    assert env.calls == ["pre", "apply", "apply", "dones", "rewards", *observe, "reset", "interval", *observe]
    assert calls
    assert obs["critic"].tolist() == [[1.0] * 3] * N
    assert env.single_observation_space["critic"].shape == (3,)
    assert env.state_space.shape == (N, 3)


def test_hooks_see_the_state_after_physics():
    seen = {}

    class Env(CartEnv):
        def _get_dones(self):
            seen["joints"] = self.sim.state.joint_q.numpy().copy()
            seen["bodies"] = self.robot.data.body_pos_w.clone()
            return super()._get_dones()

    env = make(Env)
    env.reset()
    env.step(torch.ones(N, 1))
    np.testing.assert_array_equal(seen["joints"], env.sim.state.joint_q.numpy())
    kept = seen["bodies"]
    env.sim.forward()
    torch.testing.assert_close(kept, env.robot.data.body_pos_w, atol=1e-5, rtol=0.0)


def test_state_is_of_the_new_episode_after_a_reset_in_the_step(env):
    """Trap 6: body poses follow the joints of the new episode, those of the others stay."""
    for _ in range(4):
        env.step(torch.ones(N, 1))
    env.fail[2] = True
    obs, reward, terminated, truncated, _ = env.step(torch.ones(N, 1))
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    assert env.episode_length_buf.tolist() == [5, 5, 0, 5]
    assert 0.3 <= float(obs["policy"][2, 0]) <= 0.4
    assert obs["policy"][2, 2:].tolist() == [0.0, 0.0]
    assert float(reward[2]) == pytest.approx(float(reward[1]), abs=0.2)  # of the old episode
    cart = env.robot.find_bodies("cart")[0][0]
    origin, slider = env.scene.env_origins, env.robot.find_joints("slider_to_cart")[0][0]
    moved = env.robot.data.body_pos_w[:, cart] - origin
    along = moved.abs().amax(0)[:2].argmax()
    np.testing.assert_allclose(moved[:, along].abs(), env.joint_pos[:, slider].abs(), atol=1e-5)
    assert env.robot.data.body_lin_vel_w[2].abs().max() == 0.0
    assert env.robot.data.joint_acc[2].abs().max() == 0.0


# -- spaces


@pytest.mark.parametrize(
    ("spec", "shape"),
    [(3, (3,)), ([2, 5], (2, 5)), ({4}, ()), ([{2}, {3}], (2,)), (gymnasium.spaces.Box(0, 1, (7,)), (7,))],
)
def test_spaces(spec, shape):
    assert to_space(spec).shape == shape


@pytest.mark.parametrize("spec", [0, -1, True, "four", [], {}, [1, -2], {1, 2}])
def test_what_is_no_space(spec):
    with pytest.raises(ValueError, match="is not a space"):
        to_space(spec)


def test_spaces_that_do_not_fit_are_reported_at_once():
    class Env(CartEnv):
        def _get_states(self):
            return torch.zeros(N, 5)

    env = make(Env, observation_space=7, state_space=3)
    with pytest.raises(ConfigError) as caught:
        env.reset()
    assert len(caught.value.problems) == 2
    assert "observation_space: is (7,) but the group 'policy' has (4,)" in str(caught.value)
    assert "state_space: is (3,) but the group 'critic' has (5,)" in str(caught.value)


def test_a_wrong_action_shape(env):
    for shape in ((N, 2), (N,), (1, 1)):
        with pytest.raises(ValueError, match=r"expected \(4, 1\)"):
            env.step(torch.zeros(shape))


def test_several_groups_of_observations():
    class Env(CartEnv):
        def _get_observations(self):
            return {**super()._get_observations(), "teacher": torch.ones(N, 6), "image": torch.zeros(N, 3, 2)}

    env = make(Env, observation_space={"policy": 4, "teacher": 6})
    obs, _ = env.reset()
    assert {k: tuple(v.shape) for k, v in obs.items()} == {"policy": (N, 4), "teacher": (N, 6), "image": (N, 3, 2)}
    assert env.observation_space["image"].shape == (N, 3, 2)
    assert env.single_observation_space["teacher"].shape == (6,)


def test_problems_of_the_config_come_at_once():
    cfg = CartCfg().replace(decimation=0, episode_length_s=-1.0, action_space="x", apply_action="never")
    cfg.scene.num_envs = -3
    cfg.sim.dt = 0.0
    with pytest.raises(ConfigError) as caught:
        CartEnv(cfg)
    text = str(caught.value)
    for path in ("decimation", "episode_length_s", "action_space", "apply_action", "scene.num_envs", "sim.dt"):
        assert f"  {path}: " in text, path
    with pytest.raises(TypeError, match="unexpected arguments: speed"):
        CartEnv(CartCfg(), speed=3)
    with pytest.raises(ValueError, match="render_mode: is 'human'"):
        CartEnv(CartCfg(), "human")


def test_missing_hooks_are_named():
    env = DirectRLEnv(CartCfg(observation_space=1).replace(scene=SceneOfCart(num_envs=1, env_spacing=1.0)))
    with pytest.raises(NotImplementedError, match="_get_observations"):
        env.reset()


@configclass
class SceneOfCart(InteractiveSceneCfg):
    robot = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")


# -- noise


def test_noise_models_act_on_actions_and_observations():
    constant = NoiseModelCfg(noise_cfg=ConstantNoiseCfg(bias=2.0))
    bias = NoiseModelWithAdditiveBiasCfg(
        noise_cfg=ConstantNoiseCfg(bias=0.0), bias_noise_cfg=UniformNoiseCfg(n_min=1.0, n_max=2.0)
    )
    env = make(action_noise_model=constant, observation_noise_model=bias)
    obs, _ = env.reset()
    first = obs["policy"] - env.buffer
    assert (first >= 1.0 - 1e-6).all()
    assert (first <= 2.0 + 1e-6).all()
    obs, *_ = env.step(torch.full((N, 1), 3.0))
    assert env.actions.tolist() == [[5.0]] * N
    torch.testing.assert_close(obs["policy"] - env.buffer, first, atol=1e-5, rtol=0.0)
    env.fail[0] = True
    obs, *_ = env.step(zeros(env))
    second = obs["policy"] - env.buffer
    torch.testing.assert_close(second[1:], first[1:], atol=1e-5, rtol=0.0)
    assert (second[0] - first[0]).abs().max() > 1e-3


# -- events


def test_events():
    calls: dict[str, list] = {"startup": [], "reset": [], "rare": [], "interval": [], "clock": []}

    def note(env, ids, key):
        calls[key].append(ids.tolist())

    def push(env, ids):
        env.robot.write_joint_position_to_sim(torch.full((len(ids), 2), 0.9), env_ids=ids)

    events = {
        "startup": EventTermCfg(func=note, mode="startup", params={"key": "startup"}),
        "reset": EventTermCfg(func=note, mode="reset", params={"key": "reset"}),
        "rare": EventTermCfg(func=note, mode="reset", params={"key": "rare"}, min_step_count_between_reset=5),
        "interval": EventTermCfg(func=note, mode="interval", params={"key": "interval"}, interval_range_s=(0.06, 0.06)),
        "clock": EventTermCfg(
            func=note, mode="interval", params={"key": "clock"}, interval_range_s=(0.1, 0.1), is_global_time=True
        ),
        "push": EventTermCfg(func=push, mode="interval", interval_range_s=(0.14, 0.14)),
    }
    env = make(events=events)
    everyone = list(range(N))
    assert calls["startup"] == [everyone]
    env.reset()
    assert calls["reset"] == [everyone] == calls["rare"]
    env.step(zeros(env))
    env.fail[1] = True
    env.step(zeros(env))
    env.fail[1] = False
    assert calls["reset"][1:] == [[1]]
    assert len(calls["rare"]) == 1  # two steps after the last
    env.step(zeros(env))
    assert calls["interval"] == [[0, 2, 3]]  # the clock of environment 1 began anew
    assert calls["clock"] == []
    env.step(zeros(env))
    env.step(zeros(env))
    assert calls["interval"][1:] == [[1]]
    assert calls["clock"] == [everyone]
    env.fail[1] = True
    env.step(zeros(env))
    env.fail[1] = False
    assert calls["rare"][1:] == [[1]]
    obs, *_ = env.step(zeros(env))
    assert obs["policy"][0, 0] == pytest.approx(0.9)
    bodies = env.robot.data.body_pos_w.clone()
    env.sim.forward()
    assert torch.equal(bodies, env.robot.data.body_pos_w)  # fresh for what reads it after the event


def test_events_are_checked():
    with pytest.raises(ConfigError) as caught:
        make(events={"one": EventTermCfg(func=print, mode="often"), "two": EventTermCfg(func=print, mode="interval")})
    assert "events.one.mode: is 'often'" in str(caught.value)
    assert "events.two.interval_range_s" in str(caught.value)


def test_an_event_may_randomise_dynamics():
    def heavier(env, ids):
        env.scene.controller.randomize_dynamics(ids, mass_scale=(2.0, 2.0))

    env = make(events={"mass": EventTermCfg(func=heavier, mode="startup")})
    torch.testing.assert_close(env.robot.data.body_mass, 2.0 * env.robot.data.default_mass)
