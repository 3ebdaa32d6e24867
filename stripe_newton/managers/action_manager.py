# SPDX-License-Identifier: Apache-2.0
"""Action manager: splits the policy's actions among action terms, which turn them into targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from stripe_kernels.data import ActionData
from stripe_kernels.episode import finite_action
from stripe_newton.fusion import ArgumentError, Code, HostFunction, Item, Section, TermBinding, block, code

from .action_layout import ActionLayout, lay_out
from .action_source import ActionSource
from .action_term import ActionTerm, KernelActionTerm
from .actions_cfg import ActionTermCfg
from .context import ManagerContext
from .manager_base import ManagerBase
from .term_class import make_instance

__all__ = ["ActionManager"]


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
        self._torch: dict[str, ActionTerm] = {}
        """Terms of a user's class."""
        self._views: dict[str, KernelActionTerm] = {}
        first = 0
        for name, term in self.terms(cfg, ActionTermCfg).items():
            made = self._lay_out(name, term, first)
            if made is None:
                continue
            # An earlier term that runs before each physics step must not override this one.
            made.per_substep |= any(t.per_substep and t.meets(made) for t in self._terms.values())
            self._terms[name] = made
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
        self._sources = {
            name: ActionSource(context, f"actions.{name}", term, self._data.action, self._action)
            for name, term in self._terms.items()
            if name not in self._torch
        }

    def _lay_out(self, name: str, cfg: ActionTermCfg, first: int) -> ActionLayout | None:
        """The layout of a term; None after problems. It makes the instance of a user's class."""
        path, own = f"actions.{name}", cfg.class_type
        if own is None or not cfg.is_users:
            return lay_out(self.context, path, cfg, first)
        if not issubclass(own, ActionTerm):
            self.context.problems.append(f"{path}.class_type: is '{own.__name__}', must be derived from ActionTerm")
            return None
        term = self._torch[name] = make_instance(f"{path}.class_type", own, cfg, self.context.env)
        self._instances[path] = term
        return ActionLayout(cfg, first, term.action_dim, 0, [], {}, any_joint=True)

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

    def layout(self, name: str) -> ActionLayout:
        """Joints, functions and sizes of a term."""
        return self._terms[name]

    def get_term(self, name: str) -> ActionTerm:
        """A term: the instance of a user's class, or the view of a term of kernels."""
        if name in self._torch:
            return self._torch[name]
        if name not in self._views:
            cfg = self._terms[name].cfg
            self._views[name] = (cfg.class_type or KernelActionTerm)(cfg, self.context.env, self._sources[name])
        return self._views[name]

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
        if not self._terms:
            return self.action
        return torch.cat([self._processed(name) for name in self._terms], dim=-1)

    def _processed(self, name: str) -> torch.Tensor:
        if name in self._torch:
            return self._torch[name].processed_actions
        return self.context.torch(self._sources[name].processed_array)

    # -- between steps

    def process(self, actions: torch.Tensor) -> torch.Tensor:
        """Take actions as a step does: process them, and set the targets that hold for the whole step.

        Args:
            actions: Shape ``(num_envs, total_action_dim)``.

        Returns:
            A copy of :attr:`processed_actions`.

        Raises:
            ValueError: for another shape.
        """
        expected = self.context.num_envs, self.total_action_dim
        if tuple(actions.shape) != expected:
            raise ValueError(f"actions have shape {tuple(actions.shape)}, expected {expected}")
        self.context.torch(self.input).copy_(actions)
        self._outside.run("actions", self.process_items)
        return self.processed_actions.clone()

    def apply(self) -> None:
        """Set the targets that depend on the state, as before each physics step of a step."""
        self._outside.run("actions_apply", self.apply_items)

    # -- items

    def process_items(self) -> list[Item]:
        """Items that read the actions, process them, and set the targets that hold for the whole step."""
        if self._may_be_spread():
            body = self._take_in("part")
            for source in self._sources.values():
                body += source.process_part()
            parts = self.total_action_dim
            return [Section("actions_process", body, self.active_terms, parts=parts, coalesced=True)]
        each = code("for i in range({}.shape[1]):", self._input)
        body = block(each, self._take_in("i")) if self.total_action_dim else []
        for source in self._sources.values():
            body += source.process()
        return [Section("actions_process", body, list(self._sources)), *map(self._process_torch, self._torch)]

    def _process_torch(self, name: str) -> HostFunction:
        """The item that passes a user's class its actions."""
        term, layout = self._torch[name], self._terms[name]
        actions = self.action[:, layout.first : layout.first + layout.size]
        return HostFunction("actions", lambda: term.process_actions(actions), f"torch term '{name}'", [name])

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
            if not term.is_elementwise:
                return False
            apply = term.functions["apply"]
            if any(t.meets(term) and t.functions["apply"] is apply for t in terms[:index]):
                return False
        return bool(terms)

    def apply_items(self) -> list[Section | HostFunction]:
        """Items that set targets before each physics step, for terms whose targets depend on the state."""
        items: list[Section | HostFunction] = []
        for name, term in self._terms.items():
            if name in self._torch:
                items.append(HostFunction("actions", self._torch[name].apply_actions, f"torch term '{name}'", [name]))
            elif term.per_substep:
                section = Section("actions_apply", self._sources[name].apply(), [name])
                if items and isinstance(items[-1], Section):
                    items[-1] = items[-1].joined(section)
                else:
                    items.append(section)
        return items

    def reset_items(self) -> list[Item]:
        """Items that set the actions to zero where an episode begins."""
        zero = [code("{}[env, i] = 0.0", self._action), code("{}[env, i] = 0.0", self._actions.field("prev_action"))]
        body = block(code("for i in range({}.shape[1]):", self._action), zero)
        for source in self._sources.values():
            body += source.reset()
        return [Section("actions_reset", body).only(self.context.is_reset)] if self._terms else []

    def __str__(self) -> str:
        rows = [(i, n, t.size) for i, (n, t) in enumerate(self._terms.items())]
        return self.table(f"Action terms, {self.total_action_dim} numbers", ("Index", "Name", "Size"), rows)
