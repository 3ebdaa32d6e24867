# SPDX-License-Identifier: Apache-2.0
"""Misuse of environments: a wrong call is one error that names what is wrong, and changes nothing."""

from __future__ import annotations

import copy
import pickle
import threading

import numpy as np
import pytest
import torch

from stripe_newton.envs import mdp
from stripe_newton.rl import RslRlVecEnvWrapper, ZeroPolicy, evaluate, load_checkpoint, record_video
from stripe_tasks.cartpole.direct import CartpoleEnv, CartpoleEnvCfg

INDICES = (
    r"must be bool of shape \(4,\); for indices: mask = torch.zeros\(4, dtype=torch.bool\); mask\[indices\] = True"
)


def make() -> CartpoleEnv:
    cfg = CartpoleEnvCfg(seed=0)
    cfg.sim.device, cfg.scene.num_envs = "cpu", 4
    env = CartpoleEnv(cfg)
    env.reset()
    return env


@pytest.fixture(scope="module")
def env():
    env = make()
    yield env
    env.close()


def with_state(env, **parts):
    return env.set_state(env.get_state() | parts)


CALLS = [
    (lambda env: env.reset(options={"reset_mask": torch.tensor([0, 2])}), rf"reset_mask: is torch.int64 .*{INDICES}"),
    (lambda env: env.reset(options={"reset_mask": [0, 1, 2, 3]}), INDICES),
    (lambda env: env.reset(options={"reset_mask": [True, False]}), INDICES),
    (lambda env: env.reset(options={"reset_mask": ["a"] * 4}), r"reset_mask: is \['a', 'a', 'a', 'a'\], must be bool"),
    (lambda env: env.reset(options={"mask": None}), "options: has 'mask', but a reset knows 'reset_mask' alone"),
    (lambda env: env.reset(options=[1]), r"options: is \[1\], must be None or"),
    (lambda env: env.reset(seed=-1), "seed: is -1, must be a whole number from 0"),
    (lambda env: env.reset(seed=1.5), "seed: is 1.5, must be a whole number"),
    (lambda env: env.seed(True), "seed: is True, must be"),
    (lambda env: env.seed(2**64), "seed: is 18446744073709551616, must be"),
    (lambda env: env.step("left"), r"action: is 'left', must be a tensor of shape \(4, 1\)"),
    (lambda env: env.step(None), "action: is None, must be"),
    (lambda env: env.step(torch.zeros(4, 1, dtype=torch.complex64)), "action: is torch.complex64 of shape"),
    (lambda env: env.step(torch.zeros(4, 1).to_sparse()), "action: is sparse_coo torch.float32 of shape"),
    (lambda env: env.step(torch.zeros(4, 1, device="meta")), "action: is torch.float32 .* on 'meta', without values"),
    (lambda env: copy.copy(env), r"CartpoleEnv: an environment cannot be copied or pickled; .* its config, env.cfg"),
    (lambda env: copy.deepcopy(env), "an environment cannot be copied or pickled"),
    (lambda env: pickle.dumps(env), "an environment cannot be copied or pickled"),
    (lambda env: env.step(torch.zeros(3)), r"actions have shape \(3,\), expected \(4, 1\)"),
    (lambda env: setattr(env, "episode_length_buf", torch.zeros(3)), "episode_length_buf: is torch.float32 of shape"),
    (
        lambda env: setattr(env, "episode_length_buf", float("nan")),
        "episode_length_buf: is nan, must be a whole number",
    ),
    (lambda env: env.set_state(3), r"state: is 3, must be what get_state\(\) returned"),
    (lambda env: env.set_state({}), "state.step: is missing"),
    (lambda env: with_state(env, arrays=[1]), "state.arrays: is "),
    (lambda env: with_state(env, arrays={"joint_q": "x"}), "state.arrays.joint_q: is 'x', must be a Tensor"),
    (lambda env: with_state(env, arrays={"joint_q": torch.zeros(3)}), "the state has 'joint_q' of shape"),
    (lambda env: with_state(env, step=float("nan")), "state.step: is nan"),
    (lambda env: env.evaluate(3), "term: is 3, must be a Warp function"),
    (lambda env: env.apply_event("push"), "event: is 'push', must be a Warp function"),
    (lambda env: apply(env, [7]), r"env_ids: is \[7\], must be whole numbers from 0 to 3"),
    (lambda env: apply(env, [True, False]), "env_ids: is torch.bool of shape .*; for a mask: mask.nonzero"),
    (lambda env: env.sim.step(-1), "number of steps: is -1, must be 0 or more"),
    (lambda env: env.scene[3], "the scene has names, such as 'robot', not 3; it has robot"),
    (lambda env: env.regenerate(3), "scene"),
    (lambda env: RslRlVecEnvWrapper(env, clip_actions=-1.0), "clip_actions: is -1.0, must be"),
    (lambda env: RslRlVecEnvWrapper("env"), "env: is 'env', must be a vector environment"),
    (lambda env: evaluate(*wrapped(env), 1.5), "episodes: is 1.5, must be a whole number"),
    (lambda env: record_video(*wrapped(env), "v.mp4", 0), "steps: is 0, must be a whole number"),
    (lambda env: load_checkpoint(3), "a checkpoint is given by its path, not by 3"),
    (lambda env: CartpoleEnv(CartpoleEnvCfg), "cfg: is the class CartpoleEnvCfg; call it, must be a config"),
    (lambda env: CartpoleEnv("cfg"), "cfg: is 'cfg', must be a config"),
    (
        lambda env: CartpoleEnv(env.cfg, render_mode=["human"]),
        r"render_mode: is \['human'\], must be None or 'rgb_array'",
    ),
]


def apply(env, env_ids):
    ranges = {"position_range": (0.0, 0.1), "velocity_range": (0.0, 0.1)}
    env.apply_event(mdp.reset_joints_by_offset, env_ids, **ranges)


def wrapped(env):
    outer = RslRlVecEnvWrapper(env)
    return outer, ZeroPolicy(outer)


@pytest.mark.parametrize(("call", "message"), CALLS, ids=[str(i) for i in range(len(CALLS))])
def test_a_wrong_call_is_one_error_and_changes_nothing(env, call, message):
    before = env.get_state()
    with pytest.raises((ValueError, TypeError, KeyError), match=message) as caught:
        call(env)
    assert len(str(caught.value).splitlines()) == 1
    after = env.get_state()
    assert all(torch.equal(value, after["arrays"][name]) for name, value in before["arrays"].items())


def test_right_calls(env):
    env.reset(seed=3, options={"reset_mask": np.array([True, False, True, False])})
    env.reset(options={})
    env.step([[0.0]] * 4)
    env.episode_length_buf = 3
    assert env.episode_length_buf.tolist() == [3] * 4
    for env_ids in (None, [], [0, 3], np.arange(4), torch.tensor([1]), slice(1, 3)):
        apply(env, env_ids)
    env.sim.step(2)
    env.set_state(env.get_state())


def test_after_close():
    env = make()
    state = env.get_state()
    env.close()
    action = torch.zeros(4, 1)
    calls = [
        lambda: env.step(action),
        env.reset,
        env.render,
        env.get_state,
        env.describe,
        env.finish_step,
        lambda: env.launch_step(action),
        lambda: env.set_state(state),
        lambda: env.evaluate(mdp.joint_pos_rel),
        lambda: apply(env, None),
        lambda: env.regenerate(1),
        lambda: RslRlVecEnvWrapper(env).step(action),
    ]
    for call in calls:
        with pytest.raises(RuntimeError, match="CartpoleEnv: is closed; make a new one"):
            call()
    with pytest.raises(RuntimeError, match="the simulation is closed; make a new one"):
        env.sim.step()
    env.close()


def test_made_in_an_inference_mode():
    with torch.inference_mode():
        env = make()
    env.reset()
    env.step(torch.zeros(4, 1))
    env.close()


def test_a_step_within_a_step(env):
    """Of a hook at its own environment, and of a second thread: an error, after which the environment is as before."""
    said = []

    def step():
        try:
            env.step(torch.zeros(4, 1))
        except RuntimeError as error:
            said.append(str(error))

    taken, action = env._take_action, torch.zeros(4, 1)
    env._take_action = lambda value: (step(), _run(step), taken(value))
    try:
        env.step(action)
    finally:
        del env._take_action
    assert len(said) == 2
    assert all("step() was called within a step; call it from one thread at a time" in text for text in said)
    with pytest.raises(ValueError, match="expected"):
        env.step(torch.zeros(3))
    _run(step)
    assert len(said) == 2


def _run(function):
    thread = threading.Thread(target=function)
    thread.start()
    thread.join()
