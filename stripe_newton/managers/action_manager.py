# SPDX-License-Identifier: Apache-2.0
"""What the policy does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from stripe_kernels.data import ActionData
from stripe_kernels.episode import finite_action
from stripe_kernels.mdp import ACTIONS
from stripe_newton.fusion import Item, SceneEntityCfg, Section, bind_term
from stripe_newton.matching import match_names, match_values

from .actions_cfg import ActionTermCfg, JointActionCfg, NonHolonomicActionCfg
from .context import ManagerContext
from .manager_base import ManagerBase
from .processing import delayed, noisy

__all__ = ["ActionManager"]

_PER_NUMBER = ("joint_ids", "scale", "offset", "clip", "alpha")
"""Arguments of the terms that have one entry a number."""


@dataclass
class _Term:
    cfg: ActionTermCfg
    first: int
    size: int
    processed: str
    width: int
    joints: Sequence[str]


class ActionManager(ManagerBase):
    """Splits the policy's numbers among its terms and turns them into targets.

    Attributes:
        input: Where the caller puts the actions of a step, float, shape ``(num_envs, total_action_dim)``.
    """

    name = "actions"

    def __init__(self, cfg: Any, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, _Term] = {}
        first = 0
        for name, term in self.terms(cfg, ActionTermCfg).items():
            try:
                self._terms[name] = made = self._layout(name, term, first)
            except (KeyError, ValueError) as error:
                context.problems.append(f"actions.{name}: {error.args[0]}")
                continue
            first += made.size
        for name, made in self._terms.items():
            context.action_slices[name] = made.first, made.size
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

    def _layout(self, name: str, cfg: ActionTermCfg, first: int) -> _Term:
        entity = self.context.entity(cfg.asset_name)
        names = entity.data.joint_names
        wanted = cfg.joint_names
        if isinstance(cfg, NonHolonomicActionCfg):
            wanted = (cfg.x_joint_name, cfg.y_joint_name, cfg.yaw_joint_name)
        order = cfg.preserve_order or isinstance(cfg, NonHolonomicActionCfg)
        ids = match_names(wanted, names, order, f"joint of '{cfg.asset_name}'")[0]
        size = cfg.action_size if cfg.action_size is not None else len(ids)
        width = cfg.processed_size if cfg.processed_size is not None else len(ids)
        processed = self.context.array(f"actions.{name}.processed", float, width)
        wish = self.context.scope.name(f"{name}_commands", processed)
        return _Term(cfg, first, size, wish, width, [names[i] for i in ids])

    # -- what it is

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    @property
    def action_term_dim(self) -> list[int]:
        """Numbers that each term takes."""
        return [t.size for t in self._terms.values()]

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
        if self._terms and all(self._is_elementwise(t) for t in self._terms.values()):
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
            fixed = {"action": source, "processed": f"{term.processed}[env]"}
            body += self._call(name, term, "process", fixed)
            if not term.cfg.per_substep:
                body += self._call(name, term, "apply", fixed)
        return [Section("actions_process", body, self.active_terms)]

    @staticmethod
    def _is_elementwise(term: _Term) -> bool:
        kind = getattr(term.cfg, "kind", "")
        own = term.cfg.noise is not None or term.cfg.delay_max_lag or term.cfg.per_substep
        return bool(kind) and not own and "Binary" not in kind

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
            fixed = {"action": own, "processed": f"{term.processed}[env, {span}]"}
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
            if term.cfg.per_substep:
                body += self._call(name, term, "apply", {"processed": f"{term.processed}[env]"})
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
            body += [f"for i in range({term.width}):", f"    {term.processed}[env, i] = 0.0"]
            if term.cfg.delay_max_lag:
                body += delayed(self.context, f"actions.{name}", term.size, term.cfg).reset(zero=True)
            body += self._call(name, term, "reset", {"processed": f"{term.processed}[env]"})
        return [Section("actions_reset", body, where_reset=True)] if self._terms else []

    def _prepared(self, name: str, term: _Term, source: str, body: list[str]) -> str:
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

    def _call(self, name: str, term: _Term, what: str, fixed: Mapping[str, str], span: str = "") -> list[str]:
        cfg = term.cfg
        func, params = getattr(cfg, what), dict(cfg.params)
        if isinstance(cfg, JointActionCfg):
            func, params = self._builtin(name, term, what)
        if func is None:
            return []
        body = cfg.body_name if isinstance(cfg, NonHolonomicActionCfg) else None
        params["asset_cfg"] = SceneEntityCfg(
            cfg.asset_name, joint_names=list(term.joints), body_names=body, preserve_order=True
        )
        takes = set(func.input_types)
        fixed = {k: v for k, v in fixed.items() if k in takes}
        call = bind_term(self.context, func, params, f"actions.{name}", "action", fixed)
        return [call.expression(sliced=_PER_NUMBER if span else (), span=span)] if call is not None else []

    def _builtin(self, name: str, term: _Term, what: str) -> tuple[Any, dict[str, Any]]:
        """Function of one of the terms that come with the package, and the parameters it takes."""
        cfg: Any = term.cfg
        func = getattr(ACTIONS[cfg.kind], what)
        if func is None:
            return None, {}
        given: dict[str, Any] = {"use_default_offset": getattr(cfg, "use_default_offset", None)}
        given["rescale_to_limits"] = getattr(cfg, "rescale_to_limits", None)
        joints = term.joints
        for key in ("scale", "offset", "alpha"):
            value = getattr(cfg, key, None)
            if isinstance(value, (tuple, list)):
                given[key] = list(value)
            elif value is not None:
                found = match_values(value, joints, what="joint")
                default = 0.0 if key == "offset" else 1.0
                given[key] = [found.get(i, default) for i in range(len(joints))]
        limits = [(-float("inf"), float("inf"))] * term.width
        for key, bounds in (cfg.clip or {}).items():
            for i in match_names(key, joints, what="joint")[0]:
                limits[i] = tuple(bounds)
        given["clip"] = limits
        for key in ("open", "close"):
            commands = getattr(cfg, f"{key}_command_expr", None)
            if commands is not None:
                found = match_values(commands, joints, what="joint")
                missing = [n for i, n in enumerate(joints) if i not in found]
                if missing:
                    self.context.problems.append(
                        f"actions.{name}.{key}_command_expr: has no value for {', '.join(missing)}"
                    )
                given[f"{key}_command"] = [found.get(i, 0.0) for i in range(len(joints))]
        return func, {k: v for k, v in given.items() if k in func.input_types and v is not None}

    def __str__(self) -> str:
        rows = [(i, n, t.size) for i, (n, t) in enumerate(self._terms.items())]
        return self.table(f"Action terms, {self.total_action_dim} numbers", ("Index", "Name", "Size"), rows)
