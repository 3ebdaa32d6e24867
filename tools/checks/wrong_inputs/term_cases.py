# SPDX-License-Identifier: Apache-2.0
"""Wrong terms: functions of managers that return, take or are something else, and wrong names and parameters."""

from __future__ import annotations

import random
from collections.abc import Iterator

from case import Case

__all__ = ["term_cases"]

SLOTS = {
    "rewards.alive": "RewardTermCfg(func={f}, weight=1.0)",
    "terminations.time_out": "TerminationTermCfg(func={f}, time_out=True)",
    "observations.policy.pole_pos": "ObservationTermCfg(func={f})",
    "events.reset_pole": "EventTermCfg(func={f}, mode='reset')",
}
"""Terms of the cart-pole, and what takes their place."""
FUNCTIONS = (
    "lambda env: torch.zeros(7)", "lambda env: torch.zeros(4, 1, 1)", "lambda env: torch.tensor(1.0)",
    "lambda env: None", "lambda env: 'text'", "lambda env: np.zeros(4)", "lambda env: {}", "lambda: torch.zeros(4)",
    "lambda env, limit: torch.zeros(4)", "lambda env, *, limit: torch.zeros(4)", "lambda env: torch.zeros(0)",
    "lambda env: torch.zeros(4, dtype=torch.complex64)", "3", "None", "'mdp.is_alive'", "object()", "type", "mdp",
    "mdp.joint_pos", "mdp.time_out", "mdp.joint_vel_l1", "mdp.is_alive", "torch.zeros(4)", "mdp.JointEffortActionCfg",
)  # fmt: skip
RIGHT = (
    "lambda env: torch.zeros(4)", "lambda env: torch.zeros(4, dtype=torch.int64)", "lambda env, env_ids: None",
)  # fmt: skip
MATCHING = {
    "rewards.alive": ("mdp.is_alive", "mdp.joint_vel_l1"),
    "terminations.time_out": ("mdp.time_out",),
    "observations.policy.pole_pos": ("mdp.joint_pos",),
}
"""Functions of ``mdp`` that are right in a place."""
CHANGES: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("cfg.rewards.pole_pos.params['target'] = {v}", ("target",), ("3", "-1.5", "True", "'1'.count('1')")),
    ("cfg.rewards.pole_pos.params['tagret'] = {v}", ("tagret",), ()),
    ("cfg.rewards.pole_pos.params.pop('target')", ("target",), ()),
    ("cfg.rewards.pole_pos.weight = {v}", ("weight",), ("3", "'1'.count('1')")),
    ("cfg.rewards.pole_pos = {v}", ("pole_pos",), ("None",)),
    ("cfg.rewards.pole_pos.params['asset_cfg'] = {v}", ("asset_cfg", "SceneEntityCfg"), ("'robot'",)),
    ("cfg.events.reset_pole.mode = {v}", ("mode",), ()),
    ("cfg.events.reset_pole.params['position_range'] = {v}", ("position_range",), ("(1.0, 2.0)",)),
    ("cfg.actions.joint_effort.asset_name = {v}", ("asset_name",), ("'robot'",)),
    ("cfg.actions.joint_effort.joint_names = {v}", ("joint_names",), ("['.*']",)),
    (
        "cfg.actions.joint_effort.scale = {v}",
        ("scale",),
        ("3", "-1.5", "'1'.count('1')", "True", "{'.*': 1.0}", "[1.0]"),
    ),
    ("cfg.observations.policy.pole_pos.scale = {v}", ("scale",), ("3", "'1'.count('1')", "None", "[1.0]")),
    ("cfg.observations.policy.pole_pos.clip = {v}", ("clip",), ("None", "(1.0, 2.0)")),
    ("cfg.observations.policy.history_length = {v}", ("history_length",), ("3", "'1'.count('1')", "None")),
    ("cfg.observations.policy = {v}", ("policy",), ()),
    ("cfg.rewards = {v}", ("rewards",), ("None", "{}")),
    ("cfg.actions = {v}", ("action",), ()),
)
"""Changes of the config, words of a clear message, and the values that are right."""
STEPS = "for _ in range(2): made.step(torch.zeros(4, made.single_action_space.shape[0]))"
VALUES = (
    "3", "-1.5", "'x'", "'robot'", "float('nan')", "None", "[1.0, 2.0, 3.0]", "object()", "torch.zeros(3)", "{}",
    "SceneEntityCfg('robto')", "SceneEntityCfg('robot', joint_names=['x'])", "SceneEntityCfg('robot', joint_ids=[9])",
    "['x']", "['.*']", "{'.*': 1.0}", "(1.0, 2.0)", "[1.0]", "True", "RewardTermCfg", "lambda: 3", "'1'.count('1')",
)  # fmt: skip


def term_cases(rng: random.Random, count: int) -> Iterator[Case]:
    """About so many cases."""
    for _ in range(4 * count // 100):
        if rng.random() < 0.6:
            slot, function = rng.choice(list(SLOTS)), rng.choice((*FUNCTIONS, *RIGHT))
            change, names = f"cfg.{slot} = {SLOTS[slot].format(f=function)}", [slot.rpartition(".")[2], "func"]
            may = function in RIGHT or function in MATCHING.get(slot, ())
        else:
            (template, words, right), value = rng.choice(CHANGES), rng.choice(VALUES)
            change, names = template.format(v=value), list(words)
            may = value in right
        code = f"{change}\nmade = type(env)(cfg)\nmade.reset()\n{STEPS}"
        data = {"env": "manager", "prepare": "", "code": code}
        yield Case("terms of managers", "call", change, data, names, may)
