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
    "None", "3", "-1", "'text'", "[]", "{}", "torch.zeros(3)", "torch.zeros(4, 2)", "torch.zeros(4, 1, 1)", "1.5", "object()",
    "torch.full((4, 1), float('nan'))", "torch.full((4, 1), float('inf'))", "torch.zeros(4, 1, dtype=torch.complex64)",
    "torch.tensor([0, 7])", "torch.tensor([0, 1])", "[0, 1]", "[True, False]", "torch.tensor([True, False])", "np.arange(4)",
    "np.zeros((4, 1), dtype=object)", "['a'] * 4", "torch.zeros(0)", "2**64", "float('nan')", "True", "slice(None)",
    "torch.tensor([0, 1, 2, 3])", "torch.tensor([1.0, 0.0, 0.5, 1.0])", "{'a': 1}", "[None] * 4", "b'x'", "torch.zeros(1, 4)",
)  # fmt: skip
CALLS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("env.step({v})", ("action",)),
    ("env.reset(options={{'reset_mask': {v}}})", ("reset_mask",)),
    ("env.reset(options={v})", ("options",)),
    ("env.reset(options={{'mask': {v}}})", ("mask", "reset_mask")),
    ("env.reset(seed={v})", ("seed",)),
    ("env.seed({v})", ("seed",)),
    ("env.set_state({v})", ("state",)),
    ("state = env.get_state(); state['arrays'] = {v}; env.set_state(state)", ("state", "arrays")),
    ("state = env.get_state(); state['arrays']['joint_q'] = {v}; env.set_state(state)", ("joint_q",)),
    ("state = env.get_state(); state['step'] = {v}; env.set_state(state)", ("step",)),
    ("state = env.get_state(); state['parts'] = {v}; env.set_state(state)", ("parts",)),
    ("state = env.get_state(); state['buffers'] = {v}; env.set_state(state)", ("buffers",)),
    ("env.evaluate({v})", ("term",)),
    ("env.evaluate(mdp.joint_pos_rel, asset={v})", ("asset",)),
    ("env.apply_event({v})", ("event", "term")),
    ("env.apply_event(mdp.reset_joints_by_offset, {v}, position_range=(0.0, 0.1), velocity_range=(0.0, 0.1))", ("env_ids",)),
    ("env.episode_length_buf = {v}", ("episode_length_buf",)),
    ("env.regenerate({v})", ("scene", "seed")),
    ("type(env)(cfg, render_mode={v})", ("render_mode",)),
    ("cfg.scene.num_envs = {v}; type(env)(cfg)", ("num_envs",)),
    ("cfg.seed = {v}; type(env)(cfg)", ("seed",)),
    ("cfg.decimation = {v}; type(env)(cfg)", ("decimation",)),
    ("cfg.sim = {v}; type(env)(cfg)", ("sim",)),
    ("cfg.scene = {v}; type(env)(cfg)", ("scene",)),
    ("cfg.episode_length_s = {v}; type(env)(cfg)", ("episode_length_s",)),
    ("type(env)({v})", ("cfg", "config")),
    ("env.scene[{v}]", ("scene", "entity", "no ")),
    ("env.sim.step({v})", ("step", "count", "number")),
    ("RslRlVecEnvWrapper(env, clip_actions={v})", ("clip_actions",)),
    ("RslRlVecEnvWrapper({v})", ("env",)),
    ("evaluate(RslRlVecEnvWrapper(env), ZeroPolicy(RslRlVecEnvWrapper(env)), {v})", ("episodes",)),
    ("record_video(RslRlVecEnvWrapper(env), ZeroPolicy(RslRlVecEnvWrapper(env)), 'v.mp4', {v})", ("steps", "render_mode")),
    ("RunFolder.create('logs', {v})", ("experiment", "name")),
    ("load_checkpoint({v})", ("checkpoint", "path")),
)
CLOSED = (
    "env.step(torch.zeros(4, 1))", "env.reset()", "env.render()", "env.get_state()", "env.regenerate(1)", "env.seed(3)",
    "env.evaluate(mdp.joint_pos_rel)", "env.describe()", "env.close()", "env.sim.step()", "env.finish_step()",
    "env.launch_step(torch.zeros(4, 1))", "RslRlVecEnvWrapper(env).step(torch.zeros(4, 1))",
)  # fmt: skip
HARMLESS = ("env.close()", "env.seed(3)", "env.describe()")


def call_cases(rng: random.Random, count: int) -> Iterator[Case]:
    """About so many cases."""
    for _ in range(7 * count // 100):
        env = rng.choice(list(ENVS))
        if rng.random() < 0.15:
            code = rng.choice(CLOSED)
            data = {"env": env, "prepare": "env.close()", "code": code}
            yield Case("calls of environments", "call", f"after close: {code}", data, ["closed"], code in HARMLESS)
            continue
        (call, names), value = rng.choice(CALLS), rng.choice(VALUES)
        code = call.format(v=value)
        # Many values are right for some calls: None for a seed, a mask as a list, actions as an array.
        data = {"env": env, "prepare": "", "code": code}
        yield Case("calls of environments", "call", code, data, list(names), may_pass=_may_pass(call, value))


def _may_pass(call: str, value: str) -> bool:
    """Whether a value may be right: decided by what the documentation of the call says."""
    if "reset_mask" in call and "'mask'" not in call:
        return value in ("None", "[True, False]") and value == "None"
    if call.startswith("env.step("):
        return value == "np.zeros((4, 1))"
    if "'mask'" in call or call.startswith("env.set_state") or "evaluate({v})" in call or "apply_event({v})" in call:
        return False
    if "env.reset(options={v})" in call:
        return value in ("None", "{}")
    if "seed" in call:
        return value in ("None", "3")
    if "num_envs" in call or "decimation" in call or "evaluate(Rsl" in call or "record_video" in call:
        return value in ("3",)
    if "clip_actions" in call:
        return value in ("None", "3", "1.5")
    if "render_mode" in call:
        return value == "None"
    if "env_ids" in call or "reset_joints_by_offset" in call:
        return value in ("None", "3", "[]", "torch.tensor([0, 1])", "[0, 1]", "np.arange(4)", "torch.tensor([0, 1, 2, 3])",
                         "torch.zeros(0)", "slice(None)", "-1")  # fmt: skip
    if "episode_length_buf" in call:
        return value in ("3", "torch.tensor([0, 1, 2, 3])", "np.arange(4)", "-1", "True")
    if "state['step']" in call:
        return value == "3"
    if "state['parts']" in call:
        return value in ("[]",)
    if "state['buffers']" in call:
        return value in ("{}",)
    if "sim.step" in call:
        return value == "3"
    if "episode_length_s" in call:
        return value in ("3", "1.5")
    if "RunFolder.create" in call:
        return value == "'text'"
    return False
