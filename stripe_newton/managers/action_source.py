# SPDX-License-Identifier: Apache-2.0
"""Action source: source code of an action term, which processes its actions and sets targets.

The lines of an effort on one joint, in the thread of the action's number ``part``::

    if part >= 0 and part < 1:
        process_action(env, actions.action[env, part:part + 1], ..., joint_effort_commands[env, part:part + 1])
        apply_joint_effort(env, joint_effort_commands[env, part:part + 1], robot, joint_ids[part:part + 1])
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import warp as wp

from stripe_newton.fusion import Code, SceneEntityCfg, bind_term, block, code

from .action_layout import ActionLayout
from .context import ManagerContext
from .processing import NoiseSource, delay_of
from .term_params import params_for

__all__ = ["ActionSource"]

_PER_NUMBER = ("joint_ids", "scale", "offset", "clip", "alpha")
"""Arguments of the functions that have one entry for each number."""


@dataclass(frozen=True)
class ActionSource:
    """Source code of one action term."""

    context: ManagerContext
    """Context that makes arrays and parameters."""
    path: str
    """Path of the term, such as ``actions.legs``."""
    term: ActionLayout
    """Its layout."""
    actions: wp.array
    """Actions, float, shape ``(num_envs, n)``; the term takes ``term.size`` of them from ``term.first`` on."""
    action: Code
    """Name of :attr:`actions` in the source."""

    @property
    def name(self) -> str:
        """Name of the term in the source."""
        return self.path.removeprefix("actions.")

    @property
    def processed_array(self) -> wp.array:
        """Array of the processed actions, float, shape ``(num_envs, width)``."""
        return self.context.array(f"{self.path}.processed", float, self.term.width)

    @property
    def processed(self) -> Code:
        """Name of :attr:`processed_array` in the source."""
        return self.context.scope.name(f"{self.name}_commands", self.processed_array)

    def process(self) -> list[Code]:
        """Lines that process the actions, and set the targets if these hold for the whole step."""
        term, body = self.term, list[Code]()
        source = code("{}[env, {}:{}]", self.action, term.first, term.first + term.size)
        if term.cfg.noise is not None or term.cfg.delay_max_lag:
            source = self._prepared(body)
        fixed = {"action": source, "processed": code("{}[env]", self.processed)}
        body += self._call("process", fixed)
        return body if term.per_substep else body + self._call("apply", fixed)

    def process_part(self) -> list[Code]:
        """Lines that process the action number ``part`` alone and set its target, if it belongs to the term."""
        term = self.term
        number = "part:part + 1"
        span = f"part - {term.first}:part - {term.first} + 1" if term.first else number
        fixed = {
            "action": code("{}[env, {}]", self.action, number),
            "processed": code("{}[env, {}]", self.processed, span),
        }
        lines = [*self._call("process", fixed, span), *self._call("apply", fixed, span)]
        mine = code("if part >= {} and part < {}:", term.first, term.first + term.size)
        return block(mine, lines)

    def apply(self) -> list[Code]:
        """Lines that set targets from the processed actions."""
        return self._call("apply", {"processed": code("{}[env]", self.processed)})

    def reset(self) -> list[Code]:
        """Lines that begin an episode."""
        term, processed = self.term, self.processed
        body = block(code("for i in range({}):", term.width), [code("{}[env, i] = 0.0", processed)])
        if term.cfg.delay_max_lag:
            body += delay_of(self.context, self.path, term.size, term.cfg).reset(zero=True)
        return body + self._call("reset", {"processed": code("{}[env]", processed)})

    # -- parts of them

    def _prepared(self, body: list[Code]) -> Code:
        """The actions with noise and delay, in an array of its own that lines in ``body`` fill."""
        context, term = self.context, self.term
        each = code("for i in range({}):", term.size)
        own = context.scope.name(f"{self.name}_raw", context.array(f"{self.path}.raw", float, term.size))
        element = code("{}[env, i]", own)
        body += block(each, [code("{} = {}[env, {} + i]", element, self.action, term.first)])
        if term.cfg.noise is not None:
            rng = context.code("{rng}")
            noise = NoiseSource(context, f"{self.path}.noise", term.cfg.noise, term.size, rng)
            body += block(each, noise.apply(element))
        if term.cfg.delay_max_lag:
            body += delay_of(context, self.path, term.size, term.cfg).step(element)
        return code("{}[env]", own)

    def _call(self, what: str, fixed: Mapping[str, Code], span: str = "") -> list[Code]:
        term, func = self.term, self.term.functions[what]
        if func is None:
            return []
        params = params_for(self.context.structs, func, term.cfg.params | term.values)
        bodies = getattr(term.cfg, "body_name", None)
        params.setdefault("asset_cfg", SceneEntityCfg(term.cfg.asset_name, joint_ids=term.joint_ids, body_names=bodies))
        fixed = {k: v for k, v in fixed.items() if k in func.input_types}
        call = bind_term(self.context, func, params, self.path, "action", fixed)
        return [call.expression(sliced=_PER_NUMBER if span else (), span=span)] if call is not None else []
