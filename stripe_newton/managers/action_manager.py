# SPDX-License-Identifier: Apache-2.0
"""Action manager: splits the policy's actions among action terms, which turn them into targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from stripe_kernels.data import ActionData
from stripe_kernels.episode import finite_action
from stripe_newton.fusion import (
    ArgumentError,
    Code,
    Item,
    SceneEntityCfg,
    Section,
    TermBinding,
    bind_term,
    block,
    code,
)

from .action_layout import ActionLayout, lay_out
from .actions_cfg import ActionTermCfg
from .context import ManagerContext
from .manager_base import ManagerBase
from .processing import NoiseSource, delay_of
from .term_params import params_for

__all__ = ["ActionManager"]

_PER_NUMBER = ("joint_ids", "scale", "offset", "clip", "alpha")
"""Arguments of the functions that have one entry for each number."""


class ActionStructs:
    """Resolver of ``ActionData`` for terms: all actions, or those of the action term ``action_name``."""

    def __init__(self, whole: ActionData, spans: Mapping[str, tuple[int, int]]):
        """``spans`` are the first number and the count of numbers by action term."""
        self._whole, self._spans = whole, spans
        self._parts: dict[str, ActionData] = {}

    def parameters(self, argument: str) -> Sequence[str]:
        """``action_name``, whatever the argument is called."""
        return ("action_name",)

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the actions.

        Raises:
            ArgumentError: if there is no such action term.
        """
        term, scope = binding.take("action_name"), binding.context.scope
        if term is None:
            binding.counts["num_actions"] = self._whole.action.shape[1]
            return scope.name("actions", self._whole)
        if term not in self._spans:
            raise ArgumentError(f"action_name is '{term}', must be one of {', '.join(self._spans)}")
        first, size = self._spans[str(term)]
        part = self._parts.setdefault(str(term), ActionData())
        part.action = self._whole.action[:, first : first + size]
        part.prev_action = self._whole.prev_action[:, first : first + size]
        binding.counts["num_actions"] = size
        return scope.name(f"actions_{term}", part)


class ActionManager(ManagerBase):
    """Splits the policy's actions among its terms, which turn them into targets.

    Where two terms set the same target, the later one overrides the other. Scale, offset and clip of a term are arrays
    that may be changed: ``context.arrays["actions.legs.scale"]``.

    Attributes:
        input: Memory for the actions of the next step, float, shape ``(num_envs, total_action_dim)``.
        total_action_dim: Number of actions of all terms.
    """

    name = "actions"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, ActionLayout] = {}
        first = 0
        for name, term in self.terms(cfg, ActionTermCfg).items():
            made = lay_out(context, f"actions.{name}", term, first)
            if made is None:
                continue
            # An earlier term that runs before each physics step must not override this one.
            made.per_substep |= any(t.per_substep and t.meets(made) for t in self._terms.values())
            self._terms[name] = made
            context.array(f"actions.{name}.processed", float, made.width)
            first += made.size
        self.total_action_dim = first
        self.input = context.array("actions.input", float, first)
        self._data = ActionData()
        self._data.action = context.array("actions.action", float, first)
        self._data.prev_action = context.array("actions.prev_action", float, first)
        context.structs.register(ActionData, ActionStructs(self._data, self.action_spans))
        scope = context.scope
        self._input = scope.name("action_input", self.input)
        self._actions = scope.name("actions", self._data)
        self._nonfinite = scope.name("nonfinite_actions", context.shared("actions.nonfinite", int, 1))

    # -- properties

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    @property
    def action_term_dim(self) -> list[int]:
        """Number of actions of each term."""
        return [t.size for t in self._terms.values()]

    @property
    def action_spans(self) -> dict[str, tuple[int, int]]:
        """Index of the first action and number of actions, by term."""
        return {name: (term.first, term.size) for name, term in self._terms.items()}

    def get_term(self, name: str) -> ActionLayout:
        """Joints, functions and sizes of a term."""
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
        """Processed actions of all terms, joined, shape ``(num_envs, n)``."""
        arrays = [self.context.arrays[f"actions.{name}.processed"] for name in self._terms]
        return torch.cat([self.context.torch(a) for a in arrays], dim=-1)

    # -- items

    def process_items(self) -> list[Item]:
        """Items that read the actions, process them, and set the targets that hold for the whole step."""
        if self._may_be_spread():
            return self._process_side_by_side()
        body = (
            block(code("for i in range({}.shape[1]):", self._input), self._take_in("i"))
            if self.total_action_dim
            else []
        )
        for name, term in self._terms.items():
            source = code("{}[env, {}:{}]", self._action, term.first, term.first + term.size)
            if term.cfg.noise is not None or term.cfg.delay_max_lag:
                source = self._prepared(name, term, body)
            fixed = {"action": source, "processed": code("{}[env]", self._processed(name))}
            body += self._call(name, term, "process", fixed)
            if not term.per_substep:
                body += self._call(name, term, "apply", fixed)
        return [Section("actions_process", body, self.active_terms)]

    @property
    def _action(self) -> Code:
        return self._actions.field("action")

    def _take_in(self, index: str) -> list[Code]:
        """Lines that move an action to the previous ones and read the new one, made finite."""
        previous, action = self._actions.field("prev_action"), self._action
        given = self.context.scope.call(finite_action, code("{}[env, {}]", self._input, index), self._nonfinite)
        return [
            code("{}[env, {i}] = {}[env, {i}]", previous, action, i=index),
            code("{}[env, {}] = {}", action, index, given),
        ]

    def _may_be_spread(self) -> bool:
        """Whether each number may have a thread: none depends on another, and no two terms set the same target."""
        terms = list(self._terms.values())
        for index, term in enumerate(terms):
            apply = term.functions["apply"]
            if not term.is_elementwise:
                return False
            if any(t.meets(term) and t.functions["apply"] is apply for t in terms[:index]):
                return False
        return bool(terms)

    def _process_side_by_side(self) -> list[Item]:
        """:meth:`process_items` with a thread for each number."""
        number, body = "part:part + 1", self._take_in("part")
        for name, term in self._terms.items():
            span = f"part - {term.first}:part - {term.first} + 1" if term.first else number
            fixed = {
                "action": code("{}[env, {}]", self._action, number),
                "processed": code("{}[env, {}]", self._processed(name), span),
            }
            lines = [*self._call(name, term, "process", fixed, span), *self._call(name, term, "apply", fixed, span)]
            mine = code("if part >= {} and part < {}:", term.first, term.first + term.size)
            body += block(mine, lines)
        return [Section("actions_process", body, self.active_terms, parts=self.total_action_dim)]

    def apply_items(self) -> list[Section]:
        """Sections that set targets before each physics step, for terms whose targets depend on the state."""
        body, names = list[Code](), list[str]()
        for name, term in self._terms.items():
            if term.per_substep:
                body += self._call(name, term, "apply", {"processed": code("{}[env]", self._processed(name))})
                names.append(name)
        return [Section("actions_apply", body, names)] if body else []

    def reset_items(self) -> list[Item]:
        """Items that set the actions to zero where an episode begins."""
        body = block(
            code("for i in range({}.shape[1]):", self._action),
            [code("{}[env, i] = 0.0", self._action), code("{}[env, i] = 0.0", self._actions.field("prev_action"))],
        )
        for name, term in self._terms.items():
            processed = self._processed(name)
            body += block(code("for i in range({}):", term.width), [code("{}[env, i] = 0.0", processed)])
            if term.cfg.delay_max_lag:
                body += delay_of(self.context, f"actions.{name}", term.size, term.cfg).reset(zero=True)
            body += self._call(name, term, "reset", {"processed": code("{}[env]", processed)})
        return [Section("actions_reset", body).only(self.context.is_reset)] if self._terms else []

    # -- parts of them

    def _processed(self, name: str) -> Code:
        return self.context.scope.name(f"{name}_commands", self.context.arrays[f"actions.{name}.processed"])

    def _prepared(self, name: str, term: ActionLayout, body: list[Code]) -> Code:
        """The actions of a term with noise and delay, in an array of its own that lines in ``body`` fill."""
        context, each = self.context, code("for i in range({}):", term.size)
        own = context.scope.name(f"{name}_raw", context.array(f"actions.{name}.raw", float, term.size))
        element = code("{}[env, i]", own)
        body += block(each, [code("{} = {}[env, {} + i]", element, self._action, term.first)])
        if term.cfg.noise is not None:
            path, rng = f"actions.{name}.noise", context.code("{rng}")
            body += block(each, NoiseSource(context, path, term.cfg.noise, term.size, rng).apply(element))
        if term.cfg.delay_max_lag:
            body += delay_of(context, f"actions.{name}", term.size, term.cfg).step(element)
        return code("{}[env]", own)

    def _call(self, name: str, term: ActionLayout, what: str, fixed: Mapping[str, Code], span: str = "") -> list[Code]:
        cfg, func = term.cfg, term.functions[what]
        if func is None:
            return []
        params = params_for(self.context.structs, func, cfg.params | term.values)
        entity = SceneEntityCfg(cfg.asset_name, joint_ids=term.joint_ids, body_names=getattr(cfg, "body_name", None))
        params.setdefault("asset_cfg", entity)
        fixed = {k: v for k, v in fixed.items() if k in func.input_types}
        call = bind_term(self.context, func, params, f"actions.{name}", "action", fixed)
        return [call.expression(sliced=_PER_NUMBER if span else (), span=span)] if call is not None else []

    def __str__(self) -> str:
        rows = [(i, n, t.size) for i, (n, t) in enumerate(self._terms.items())]
        return self.table(f"Action terms, {self.total_action_dim} numbers", ("Index", "Name", "Size"), rows)
