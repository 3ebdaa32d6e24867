# SPDX-License-Identifier: Apache-2.0
"""Safety: states and actions that are not finite, in all kinds of environments; hooks that are defined twice."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
import warp as wp

from stripe_newton.envs import DirectRLEnv, ManagerBasedRLEnv
from stripe_tasks.cartpole import CartpoleEnv, CartpoleEnvCfg
from stripe_tasks.cartpole.direct_warp import CartpoleWarpEnv
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg

N, BAD = 6, 2
OTHERS = [i for i in range(N) if i != BAD]
KINDS = {
    "manager": (ManagerBasedRLEnv, CartpoleManagerEnvCfg),
    "warp": (CartpoleWarpEnv, CartpoleEnvCfg),
    "torch": (CartpoleEnv, CartpoleEnvCfg),
}


def make(kind: str, **changes: Any) -> Any:
    cls, cfg_class = KINDS[kind]
    cfg = cfg_class().replace(**changes)
    cfg.sim.device, cfg.scene.num_envs = "cpu", N
    return cls(cfg)


def actions_of(step: int) -> torch.Tensor:
    return 0.1 * torch.sin(1.3 * step + torch.arange(N, dtype=torch.float32))[:, None]


def put(env: Any) -> None:
    """Poles that stay up for a while, whatever the form draws at a reset."""
    data = env.scene["robot"].data
    data.joint_pos[:] = 0.0
    data.joint_pos[:, 1] = 0.02 * torch.arange(N, dtype=torch.float32)
    data.joint_vel.zero_()
    env.sim.forward()


@pytest.fixture(params=list(KINDS))
def kind(request) -> str:
    return request.param


def pair(kind: str, **changes: Any) -> tuple[Any, Any]:
    """Two environments in the same state after three steps."""
    envs = make(kind, **changes), make(kind, **changes)
    for env in envs:
        env.reset(seed=5)
        put(env)
        for k in range(3):
            env.step(actions_of(k))
    return envs


# -- worlds


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("what", ["joint_pos", "joint_vel"])
def test_a_world_that_is_not_finite_begins_anew_alone(kind, what, value):
    env, twin = pair(kind, compute_final_obs=True)
    getattr(env.scene["robot"].data, what)[BAD] = value
    assert env.nonfinite_worlds == 0
    out, other = env.step(actions_of(3)), twin.step(actions_of(3))
    obs, reward, terminated, truncated, extras = out
    assert terminated.tolist() == [i == BAD for i in range(N)]
    assert not truncated.any()
    assert env.nonfinite_worlds == 1
    assert twin.nonfinite_worlds == 0
    assert reward[BAD] == 0.0
    assert torch.isfinite(obs["policy"]).all()
    assert torch.isfinite(extras["final_obs"]["policy"]).all()
    assert extras["_final_obs"].tolist() == terminated.tolist()
    assert torch.isfinite(reward).all()
    assert all(torch.isfinite(v).all() for v in extras["log"].values())
    assert env.episode_length_buf.tolist() == [0 if i == BAD else 4 for i in range(N)]
    assert (obs["policy"][BAD, 1:] == 0.0).all()
    for k in range(4, 30):
        for one, two in zip(out[:4], other[:4], strict=True):
            one, two = (v["policy"] if isinstance(v, dict) else v for v in (one, two))
            assert torch.equal(one[OTHERS], two[OTHERS]), k
        out, other = env.step(actions_of(k)), twin.step(actions_of(k))
        assert torch.isfinite(out[0]["policy"]).all()
        assert torch.isfinite(out[1]).all()
    assert env.nonfinite_worlds == 1
    mine, its = (e.get_state()["arrays"] for e in (env, twin))
    for name, array in mine.items():
        assert torch.equal(torch.isfinite(array), torch.isfinite(its[name])), name


def test_it_goes_on_as_any_other(kind):
    """Nothing of the broken episode is left: from the same state it steps as a world that was never broken."""
    env, twin = pair(kind)
    env.scene["robot"].data.joint_vel[BAD] = math.nan
    env.step(actions_of(3))
    twin.reset(options={"reset_mask": torch.arange(N) == BAD})
    for e in (env, twin):
        put(e)
        e.reset_buf.zero_()
    for k in range(3):
        one, two = env.step(actions_of(k)), twin.step(actions_of(k))
        assert torch.equal(one[0]["policy"][BAD], two[0]["policy"][BAD])
        assert torch.equal(one[1][BAD], two[1][BAD])


def test_several_worlds_are_counted(kind):
    env, _ = pair(kind)
    for count in (1, 3, 6):
        before = env.nonfinite_worlds
        env.scene["robot"].data.joint_pos[:count] = math.nan
        assert int(env.step(actions_of(0))[2].sum()) == count
        assert env.nonfinite_worlds - before == count


def test_the_log_of_managers_counts_them():
    env, _ = pair("manager")
    assert float(env.step(actions_of(3))[4]["log"]["Episode_Termination/non_finite"]) == 0.0
    env.scene["robot"].data.joint_pos[:2] = math.nan
    log = env.step(actions_of(4))[4]["log"]
    assert float(log["Episode_Termination/non_finite"]) == 2.0
    assert float(log["Episode_Termination/pole_fallen"]) == 0.0
    assert all(math.isfinite(float(v)) for v in log.values())


def test_a_broken_world_is_mended_by_a_reset(kind):
    env, _ = pair(kind)
    env.scene["robot"].data.joint_pos[BAD] = math.nan
    obs, _ = env.reset(options={"reset_mask": torch.arange(N) == BAD})
    assert torch.isfinite(obs["policy"]).all()
    out = env.step(actions_of(0))
    assert not out[2].any()
    assert torch.isfinite(out[0]["policy"]).all()


# -- actions


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_actions_that_are_not_finite_are_an_error(kind, value):
    env, twin = pair(kind)
    actions = actions_of(3)
    actions[[1, 4]] = value
    with pytest.raises(ValueError, match=r"actions of 2 environments are not finite \(environments 1, 4\)"):
        env.step(actions)
    assert env.common_step_counter == 3
    one, two = env.step(actions_of(3)), twin.step(actions_of(3))  # nothing was done
    assert torch.equal(one[0]["policy"], two[0]["policy"])


def test_many_bad_actions_name_the_first(kind):
    env = make(kind)
    env.reset()
    with pytest.raises(ValueError, match=r"actions of 6 environments .*\(environments 0, 1, 2, 3, 4\).*clamp"):
        env.step(torch.full((N, 1), math.nan))


@pytest.mark.parametrize(("value", "instead"), [(math.nan, 0.0), (math.inf, 1.0e6), (-math.inf, -1.0e6)])
def test_actions_are_clamped_on_request(kind, value, instead):
    env, twin = pair(kind, nonfinite_actions="clamp")
    actions, finite = actions_of(3), actions_of(3)
    actions[BAD], finite[BAD] = value, instead
    one, two = env.step(actions), twin.step(finite)
    assert torch.equal(one[0]["policy"][OTHERS], two[0]["policy"][OTHERS])
    assert torch.isfinite(one[0]["policy"]).all()
    assert torch.isfinite(one[1]).all()
    assert torch.equal(one[1], two[1])
    assert torch.equal(one[2], two[2])
    for k in range(4, 10):
        assert torch.isfinite(env.step(actions_of(k))[0]["policy"]).all()


def test_torch_hooks_get_clamped_actions():
    env, _ = pair("torch", nonfinite_actions="clamp")
    seen = []
    env._pre_physics_step = lambda actions: seen.append(actions.clone()) or setattr(env, "actions", 0.0 * actions)
    actions = torch.zeros(N, 1)
    actions[:3] = torch.tensor([[math.nan], [math.inf], [-math.inf]])
    env.step(actions)
    assert seen[0][:3, 0].tolist() == [0.0, 1.0e6, -1.0e6]


def test_what_to_do_must_be_known():
    with pytest.raises(ValueError, match="nonfinite_actions: is 'ignore', must be 'raise' or 'clamp'"):
        make("manager", nonfinite_actions="ignore")


@pytest.mark.parametrize("shape", [(N,), (N, 2), (N - 1, 1), (1, N), (N, 1, 1)])
def test_actions_of_a_wrong_shape_are_refused(kind, shape):
    env = make(kind)
    env.reset()
    with pytest.raises(ValueError) as caught:
        env.step(torch.zeros(shape))
    assert str(caught.value) == f"actions have shape {shape}, expected ({N}, 1)"
    assert env.common_step_counter == 0


# -- hooks


PAIRS = {
    "_pre_physics_step": "_launch_pre_physics_step",
    "_apply_action": "_launch_apply_action",
    "_get_dones": "_launch_dones",
    "_get_rewards": "_launch_rewards",
    "_reset_idx": "_launch_reset",
    "_get_observations": "_launch_observations",
}


@pytest.mark.parametrize("hook", list(PAIRS))
def test_a_hook_filled_twice_is_refused(hook):
    both = {name: lambda self, *args: None for name in (hook, PAIRS[hook])}
    cls = type("TwiceEnv", (DirectRLEnv,), both)
    with pytest.raises(TypeError, match=f"TwiceEnv fills {hook} and {PAIRS[hook]}: fill one of the two"):
        cls(CartpoleEnvCfg())


def test_all_hooks_filled_twice_are_named():
    class Env(CartpoleWarpEnv):
        def _get_dones(self):
            return None

        def _get_rewards(self):
            return None

    with pytest.raises(TypeError, match="_get_dones and _launch_dones; _get_rewards and _launch_rewards"):
        Env(CartpoleEnvCfg())


def test_torch_and_warp_hooks_side_by_side():
    """Rewards in torch beside everything else in Warp: the same numbers, and the broken world gets none."""

    class Env(CartpoleWarpEnv):
        _launch_rewards = DirectRLEnv._launch_rewards

        def _get_rewards(self) -> torch.Tensor:
            reward = wp.zeros(self.num_envs, dtype=float)
            kept, self.warp.reward = self.warp.reward, reward
            CartpoleWarpEnv._launch_rewards(self)
            self.warp.reward = kept
            return wp.to_torch(reward)

    cfg = CartpoleEnvCfg()
    cfg.sim.device, cfg.scene.num_envs = "cpu", N
    env, twin = Env(cfg), make("warp")
    for e in (env, twin):
        e.reset(seed=5)
        put(e)
    for k in range(20):
        one, two = env.step(actions_of(k)), twin.step(actions_of(k))
        assert torch.equal(one[1], two[1])
        assert torch.equal(one[0]["policy"], two[0]["policy"])
    env.scene["robot"].data.joint_pos[BAD] = math.nan
    assert env.step(actions_of(0))[1][BAD] == 0.0
    assert "torch hook" in env.describe()
