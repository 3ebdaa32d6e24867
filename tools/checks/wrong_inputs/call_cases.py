# SPDX-License-Identifier: Apache-2.0
"""Wrong calls of an environment: actions, resets, states, seeds, calls after its end."""

from __future__ import annotations

import random
from collections.abc import Iterator

from case import Case

__all__ = ["ENVS", "call_cases"]

ENVS = {
    "direct": ("stripe_tasks.cartpole.direct:CartpoleEnv", "stripe_tasks.cartpole.direct:CartpoleEnvCfg"),
    "manager": (
        "stripe_newton.envs:ManagerBasedRLEnv",
        "stripe_tasks.cartpole.manager_based:CartpoleManagerEnvCfg",
    ),
}
"""Class and config of the environments, each with 4 environments."""

VALUES = (
    "None", "3", "-1", "'text'", "[]", "{}", "torch.zeros(3)", "torch.zeros(4, 2)", "torch.zeros(4, 1, 1)", "1.5",
    "torch.full((4, 1), float('nan'))", "torch.full((4, 1), float('inf'))", "torch.zeros(4, 1, dtype=torch.complex64)",
    "torch.tensor([0, 7])", "torch.tensor([0, 1])", "[0, 1]", "[True, False]", "torch.tensor([True, False])",
    "np.zeros((4, 1), dtype=object)", "['a'] * 4", "torch.zeros(0)", "2**64", "float('nan')", "True", "slice(None)",
    "torch.tensor([0, 1, 2, 3])", "torch.tensor([1.0, 0.0, 0.5, 1.0])", "{'a': 1}", "[None] * 4", "b'x'", "object()",
    "np.arange(4)", "torch.zeros(1, 4)",
)  # fmt: skip
NO_VALUES: tuple[str, ...] = ()
SEEDS = ("None", "3")
ENV_IDS = ("None", "3", "[]", "[0, 1]", "np.arange(4)", "torch.tensor([0, 1])", "torch.tensor([0, 1, 2, 3])",
           "torch.zeros(0)", "slice(None)", "-1")  # fmt: skip
WRAPPED = "RslRlVecEnvWrapper(env), ZeroPolicy(RslRlVecEnvWrapper(env))"
CLIPPED = "RslRlVecEnvWrapper(env, clip_actions={v}).step(torch.ones(4, 1))"
RESET = "env.apply_event(mdp.reset_joints_by_offset, {v}, position_range=(0.0, 0.1), velocity_range=(0.0, 0.1))"
CALLS: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("env.step({v})", ("action",), NO_VALUES),
    ("env.reset(options={{'reset_mask': {v}}})", ("reset_mask",), ("None",)),
    ("env.reset(options={v})", ("options",), ("None", "{}")),
    ("env.reset(options={{'mask': {v}}})", ("mask", "reset_mask"), NO_VALUES),
    ("env.reset(seed={v})", ("seed",), SEEDS),
    ("env.seed({v})", ("seed",), SEEDS),
    ("env.set_state({v})", ("state",), NO_VALUES),
    ("state = env.get_state(); state['arrays'] = {v}; env.set_state(state)", ("state", "arrays"), NO_VALUES),
    ("state = env.get_state(); state['arrays']['joint_q'] = {v}; env.set_state(state)", ("joint_q",), NO_VALUES),
    ("state = env.get_state(); state['step'] = {v}; env.set_state(state)", ("step",), ("3",)),
    ("state = env.get_state(); state['parts'] = {v}; env.set_state(state)", ("parts",), ("[]",)),
    ("state = env.get_state(); state['buffers'] = {v}; env.set_state(state)", ("buffers",), ("{}",)),
    ("env.evaluate({v})", ("term",), NO_VALUES),
    ("env.evaluate(mdp.joint_pos_rel, asset={v})", ("asset",), NO_VALUES),
    ("env.apply_event({v})", ("event", "term"), NO_VALUES),
    (RESET, ("env_ids",), ENV_IDS),
    (
        "env.episode_length_buf = {v}",
        ("episode_length_buf",),
        ("3", "torch.tensor([0, 1, 2, 3])", "np.arange(4)", "-1", "True"),
    ),
    ("env.regenerate({v})", ("scene", "seed"), SEEDS),
    ("type(env)(cfg, render_mode={v})", ("render_mode",), ("None",)),
    ("cfg.scene.num_envs = {v}; type(env)(cfg)", ("num_envs",), ("3",)),
    ("cfg.seed = {v}; type(env)(cfg)", ("seed",), SEEDS),
    ("cfg.decimation = {v}; type(env)(cfg)", ("decimation",), ("3",)),
    ("cfg.sim = {v}; type(env)(cfg)", ("sim",), NO_VALUES),
    ("cfg.scene = {v}; type(env)(cfg)", ("scene",), NO_VALUES),
    ("cfg.episode_length_s = {v}; type(env)(cfg)", ("episode_length_s",), ("3", "1.5")),
    ("type(env)({v})", ("cfg", "config"), NO_VALUES),
    ("env.scene[{v}]", ("scene", "entity", "no "), NO_VALUES),
    ("env.sim.step({v})", ("step", "count", "number"), ("3",)),
    (
        "RslRlVecEnvWrapper(env, clip_actions={v}).step(torch.ones(4, 1))",
        ("clip_actions",),
        ("None", "3", "1.5", "2**64"),
    ),
    ("RslRlVecEnvWrapper({v})", ("env",), NO_VALUES),
    (f"evaluate({WRAPPED}, {{v}})", ("episodes",), ("3",)),
    (f"record_video({WRAPPED}, 'v.mp4', {{v}})", ("steps", "render_mode"), ("3",)),
    ("RunFolder.create('logs', {v})", ("experiment", "name"), ("'text'",)),
    ("load_checkpoint({v})", ("checkpoint", "path"), NO_VALUES),
)
"""Calls, words of a clear message, and the values that are right; all others are wrong by the documentation."""
CLOSED = (
    "env.step(torch.zeros(4, 1))", "env.reset()", "env.render()", "env.get_state()", "env.regenerate(1)", "env.seed(3)",
    "env.evaluate(mdp.joint_pos_rel)", "env.describe()", "env.close()", "env.sim.step()", "env.finish_step()",
    "env.launch_step(torch.zeros(4, 1))", "RslRlVecEnvWrapper(env).step(torch.zeros(4, 1))",
)  # fmt: skip
HARMLESS = ("env.close()", "env.seed(3)", "env.describe()")


def call_cases(rng: random.Random, count: int) -> Iterator[Case]:
    """About so many cases."""
    for _ in range(4 * count // 100):
        env = rng.choice(list(ENVS))
        if rng.random() < 0.15:
            code = rng.choice(CLOSED)
            data = {"env": env, "prepare": "env.close()", "code": code}
            yield Case("calls of environments", "call", f"after close: {code}", data, ["closed"], code in HARMLESS)
            continue
        (call, names, right), value = rng.choice(CALLS), rng.choice(VALUES)
        code = call.format(v=value)
        data = {"env": env, "prepare": "", "code": code}
        yield Case("calls of environments", "call", code, data, list(names), may_pass=value in right)
