# SPDX-License-Identifier: Apache-2.0
"""State of DirectRLEnv: recovery, seeds, saving and restoring, several environments in one process."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.envs import EventTermCfg
from stripe_newton.noise import ConstantNoiseCfg, NoiseModelWithAdditiveBiasCfg, UniformNoiseCfg
from tests.helpers.cart_env import CartCfg, CartEnv, N, make, rollout, zeros


@pytest.fixture
def env():
    env = make()
    env.reset(seed=3)
    return env


# -- robustness


@pytest.mark.parametrize("where", ["position", "velocity"])
def test_a_world_that_became_nan_recovers_alone(env, where):
    """Trap 4."""
    twin = make()
    twin.reset(seed=3)
    for e in (env, twin):
        for _ in range(2):
            e.step(zeros(e))
    {"position": env.joint_pos, "velocity": env.joint_vel}[where][1] = float("nan")
    obs, _, terminated, *_ = env.step(zeros(env))
    twin.fail[1] = True
    twin.step(zeros(twin))
    twin.fail[1] = False
    assert terminated.tolist() == [False, True, False, False]
    assert torch.isfinite(obs["policy"]).all()
    for _ in range(5):
        obs, *_ = env.step(torch.ones(N, 1))
        other, *_ = twin.step(torch.ones(N, 1))
        assert torch.isfinite(obs["policy"]).all()
        assert torch.equal(obs["policy"][[0, 2, 3]], other["policy"][[0, 2, 3]])
    fresh = make()
    fresh.reset()
    for e in (fresh, env):
        e.robot.write_joint_state_to_sim(torch.full((N, 2), 0.2), torch.full((N, 2), 0.1))
        e.robot.reset()
    assert torch.equal(fresh.step(zeros(env))[0]["policy"], env.step(zeros(env))[0]["policy"])
    assert torch.isfinite(env.robot.data.body_state_w).all()


def test_seeds_reproduce():
    one, two, three = make(seed=11), make(seed=11), make(seed=12)
    a, b, c = [], [], []
    for env, out in ((one, a), (two, b), (three, c)):
        env.seed(env.cfg.seed)
        env.reset()
        out.append(rollout(env))
    assert torch.equal(a[0], b[0])
    assert not torch.equal(a[0], c[0])
    assert torch.equal(*[(one.reset(seed=5)[0]["policy"], rollout(one))[1] for _ in range(2)])
    draws = []
    for _ in range(2):
        one.reset(seed=5)
        draws.append(float(one.np_random.random()))
    assert draws[0] == draws[1]


def test_state_goes_on_where_it_stopped():
    env, other = make(), make()
    env.reset(seed=4)
    other.reset(seed=9)
    rollout(env, 5)
    rollout(other, 3)
    state = env.get_state()
    generator = torch.get_rng_state()
    expected = rollout(env)
    other.set_state(state)
    torch.set_rng_state(generator)
    assert other.common_step_counter == 5
    assert other.episode_length_buf.tolist() == [5] * N
    assert torch.equal(rollout(other), expected)
    env.set_state(state)
    torch.set_rng_state(generator)
    assert torch.equal(rollout(env), expected)


def test_state_holds_clocks_wrenches_and_biases():
    def note(env, ids):
        env.pushed = getattr(env, "pushed", 0) + len(ids)

    event = EventTermCfg(func=note, mode="interval", interval_range_s=(0.1, 0.9))
    noise = NoiseModelWithAdditiveBiasCfg(noise_cfg=ConstantNoiseCfg(), bias_noise_cfg=UniformNoiseCfg())
    env, other = (make(events={"push": event}, observation_noise_model=noise) for _ in range(2))
    env.reset(seed=1)
    force = torch.ones(N, env.robot.num_bodies, 3)
    env.robot.set_external_force_and_torque(force, force, is_global=True)
    rollout(env, 3)
    other.reset(seed=2)
    state, generator = env.get_state(), torch.get_rng_state()
    expected = rollout(env, 6)
    other.set_state(state)
    torch.set_rng_state(generator)
    assert torch.equal(rollout(other, 6), expected)
    torch.save(state, "state.pt")
    torch.load("state.pt", weights_only=True)


def test_state_holds_randomised_dynamics():
    def draw(env, ids):
        env.scene.controller.randomize_dynamics(ids, mass_scale=(0.5, 2.0), damping_scale=(0.5, 2.0))

    env, other = make(events={"mass": EventTermCfg(func=draw, mode="startup")}), make()
    env.reset(seed=1)
    state, generator = env.get_state(), torch.get_rng_state()
    expected = rollout(env, 5)
    other.set_state(state)
    torch.set_rng_state(generator)
    assert torch.equal(rollout(other, 5), expected)
    assert torch.equal(env.robot.data.body_mass, other.robot.data.body_mass)
    other.scene.controller.randomize_dynamics(mass_scale=(1.0, 1.0))  # still from the values as built
    assert torch.equal(other.robot.data.body_mass, other.robot.data.default_mass)


def test_state_of_another_size_is_refused(env):
    cfg = CartCfg()
    cfg.scene.num_envs = 2
    with pytest.raises(ValueError, match="another task or size"):
        CartEnv(cfg).set_state(env.get_state())


def test_two_environments_do_not_disturb_each_other():
    alone = make()
    alone.reset(seed=2)
    expected = rollout(alone, 8)
    one, two = make(), make(start=-0.5)
    two.reset()
    one.reset(seed=2)
    got = []
    for k in range(8):
        got.append(one.step(torch.sin(torch.arange(N).float() + k)[:, None])[0]["policy"])
        two.step(-torch.ones(N, 1))
    assert torch.equal(torch.stack(got), expected)
    two.close()
    two.close()
    one.step(zeros(one))


def test_inference_mode_leaves_no_trace(env):
    with torch.inference_mode():
        env.step(torch.ones(N, 1))
    env.reset()
    env.step(torch.ones(N, 1))
    env.actions += 1.0
    actions = torch.ones(N, 1, requires_grad=True)
    obs, *_ = env.step(actions)
    assert not obs["policy"].requires_grad
    assert not env.robot.data.joint_effort_target.requires_grad
