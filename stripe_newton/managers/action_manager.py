# SPDX-License-Identifier: Apache-2.0
"""What the policy does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from stripe_kernels.data import ActionData
from stripe_kernels.episode import finite_action
from stripe_newton.fusion import Item, SceneEntityCfg, Section, bind_term

from .action_layout import ActionLayout, lay_out
from .actions_cfg import ActionTermCfg
from .context import ManagerContext
from .manager_base import ManagerBase
from .processing import delayed, noisy
from .term_params import params_for

__all__ = ["ActionManager"]

_PER_NUMBER = ("joint_ids", "scale", "offset", "clip", "alpha")
"""Arguments of the terms that have one entry a number."""


class ActionManager(ManagerBase):
    """Splits the policy's numbers among its terms and turns them into targets.

    Where two terms set the same target, that of the later one holds. What a term scales, shifts and clips by are arrays
    that may change: ``context.arrays["actions.legs.scale"]``.

    Attributes:
        input: Where the caller puts the actions of a step, float, shape ``(num_envs, total_action_dim)``.
    """

    name = "actions"

    def __init__(self, cfg: Any, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, ActionLayout] = {}
        first = 0
        for name, term in self.terms(cfg, ActionTermCfg).items():
            made = lay_out(context, f"actions.{name}", term, first)
            if made is None:
                continue
            # An earlier term that runs before each physics step must not hold against this one.
            made.per_substep |= any(t.per_substep and t.meets(made) for t in self._terms.values())
            self._terms[name] = made
            context.action_slices[name] = first, made.size
            context.array(f"actions.{name}.processed", float, made.width)
            first += made.size
        self.total_action_dim = first
        self.input = context.array("actions.input", float, first)
        self._data = ActionData()
        self._data.action = context.array("actions.action", float, first)
        self._data.prev_action = context.array("actions.prev_action", float, first)
        context.provide(self._data, "actions")
        bad = context.shared("actions.nonfinite", int, 1)
        scope = context.scope
        self._names = {
            "input": scope.name("action_input", self.input),
            "actions": scope.name("actions", self._data),
            "bad": scope.name("nonfinite_actions", bad),
            "finite": scope.function(finite_action),
        }

    # -- what it is

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    @property
    def action_term_dim(self) -> list[int]:
        """Numbers that each term takes."""
        return [t.size for t in self._terms.values()]

    def get_term(self, name: str) -> ActionLayout:
        """Joints, functions and numbers of a term."""
        return self._terms[name]

    @property
    def action(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, total_action_dim)``."""
        return self.context.torch(self._data.action)

    @property
    def prev_action(self) -> torch.Tensor:
        """Actions of the step before it, shape ``(num_envs, total_action_dim)``."""
        return self.context.torch(self._data.prev_action)

    @property
    def processed_actions(self) -> torch.Tensor:
        """Commands of all terms side by side, shape ``(num_envs, n)``."""
        arrays = [self.context.arrays[f"actions.{name}.processed"] for name in self._terms]
        return torch.cat([self.context.torch(a) for a in arrays], dim=-1)

    # -- items

    def process(self) -> list[Item]:
        """Items that take the actions in and set the targets that hold for the whole step."""
        if self._may_be_spread():
            return self._process_side_by_side()
        names, body = self._names, []
        if self.total_action_dim:
            body = [
                f"for i in range({names['input']}.shape[1]):",
                f"    {names['actions']}.prev_action[env, i] = {names['actions']}.action[env, i]",
                f"    {names['actions']}.action[env, i] = {names['finite']}({names['input']}[env, i], {names['bad']})",
            ]
        for name, term in self._terms.items():
            source = f"{names['actions']}.action[env, {term.first}:{term.first + term.size}]"
            if term.cfg.noise is not None or term.cfg.delay_max_lag:
                source = self._prepared(name, term, source, body)
            fixed = {"action": source, "processed": f"{self._processed(name)}[env]"}
            body += self._call(name, term, "process", fixed)
            if not term.per_substep:
                body += self._call(name, term, "apply", fixed)
        return [Section("actions_process", body, self.active_terms)]

    def _may_be_spread(self) -> bool:
        """Whether threads may share the work: no number depends on another, and no two terms set the same target."""
        terms = list(self._terms.values())
        for index, term in enumerate(terms):
            apply = term.functions["apply"]
            if not term.is_elementwise:
                return False
            if any(t.meets(term) and t.functions["apply"] is apply for t in terms[:index]):
                return False
        return bool(terms)

    def _process_side_by_side(self) -> list[Item]:
        """:meth:`process` with a thread for each number, as its terms treat each on its own."""
        names, number = self._names, "part:part + 1"
        body = [
            f"{names['actions']}.prev_action[env, part] = {names['actions']}.action[env, part]",
            f"{names['actions']}.action[env, part] = {names['finite']}({names['input']}[env, part], {names['bad']})",
        ]
        for name, term in self._terms.items():
            span = f"part - {term.first}:part - {term.first} + 1" if term.first else number
            own = f"{names['actions']}.action[env, {number}]"
            fixed = {"action": own, "processed": f"{self._processed(name)}[env, {span}]"}
            lines = [
                *self._call(name, term, "process", fixed, span),
                *self._call(name, term, "apply", fixed, span),
            ]
            body += [f"if part >= {term.first} and part < {term.first + term.size}:", *(f"    {x}" for x in lines)]
        return [Section("actions_process", body, self.active_terms, parts=self.total_action_dim)]

    def apply(self) -> list[Item]:
        """Items that set targets before each physics step, for terms whose targets depend on the state."""
        body, names = [], []
        for name, term in self._terms.items():
            if term.per_substep:
                body += self._call(name, term, "apply", {"processed": f"{self._processed(name)}[env]"})
                names.append(name)
        return [Section("actions_apply", body, names)] if body else []

    def reset(self) -> list[Item]:
        """Items that start episodes: no actions yet."""
        names = self._names
        body = [
            f"for i in range({names['actions']}.action.shape[1]):",
            f"    {names['actions']}.action[env, i] = 0.0",
            f"    {names['actions']}.prev_action[env, i] = 0.0",
        ]
        for name, term in self._terms.items():
            body += [f"for i in range({term.width}):", f"    {self._processed(name)}[env, i] = 0.0"]
            if term.cfg.delay_max_lag:
                body += delayed(self.context, f"actions.{name}", term.size, term.cfg).reset(zero=True)
            body += self._call(name, term, "reset", {"processed": f"{self._processed(name)}[env]"})
        return [Section("actions_reset", body, where_reset=True)] if self._terms else []

    def _processed(self, name: str) -> str:
        return str(self.context.scope.name(f"{name}_commands", self.context.arrays[f"actions.{name}.processed"]))

    def _prepared(self, name: str, term: ActionLayout, source: str, body: list[str]) -> str:
        """The actions of a term with noise and delay, in an array of its own."""
        context = self.context
        own = context.scope.name(f"{name}_raw", context.array(f"actions.{name}.raw", float, term.size))
        body += [
            f"for i in range({term.size}):",
            f"    {own}[env, i] = {self._names['actions']}.action[env, {term.first} + i]",
        ]
        if term.cfg.noise is not None:
            lines = noisy(context, f"actions.{name}.noise", term.cfg.noise, term.size, f"{own}[env, i]")
            body += [f"for i in range({term.size}):", *(f"    {line}" for line in lines)]
        if term.cfg.delay_max_lag:
            body += delayed(context, f"actions.{name}", term.size, term.cfg).step(f"{own}[env, i]")
        return f"{own}[env]"

    def _call(self, name: str, term: ActionLayout, what: str, fixed: Mapping[str, str], span: str = "") -> list[str]:
        cfg, func = term.cfg, term.functions[what]
        if func is None:
            return []
        params = params_for(func, cfg.params | term.values)
        entity = SceneEntityCfg(cfg.asset_name, joint_ids=term.joint_ids, body_names=getattr(cfg, "body_name", None))
        params.setdefault("asset_cfg", entity)
        fixed = {k: v for k, v in fixed.items() if k in func.input_types}
        call = bind_term(self.context, func, params, f"actions.{name}", "action", fixed)
        return [call.expression(sliced=_PER_NUMBER if span else (), span=span)] if call is not None else []

    def __str__(self) -> str:
        rows = [(i, n, t.size) for i, (n, t) in enumerate(self._terms.items())]
        return self.table(f"Action terms, {self.total_action_dim} numbers", ("Index", "Name", "Size"), rows)
