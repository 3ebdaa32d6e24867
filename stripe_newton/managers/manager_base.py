# SPDX-License-Identifier: Apache-2.0
"""Manager base: terms of one kind, read from a config and turned into the items of a step."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, TypeGuard, TypeVar

import warp as wp

from stripe_newton.configclass import MISSING, is_config
from stripe_newton.fusion import HostFunction, Item, resolve_entities
from stripe_newton.matching import match_names

from .context import ManagerContext
from .outside_step import OutsideStep
from .term_class import HasReset, ManagerTermBase, has_own_reset, make_instance

__all__ = ["ManagerBase", "TermFunction", "is_warp_term", "terms_of", "with_terms"]

TermFunction = Callable[..., object]
"""Function of a term: a Warp function, or a torch function that takes the environment."""
Term = TypeVar("Term")


def is_warp_term(func: object) -> TypeGuard[wp.Function]:
    """Whether a term is a Warp function; any other callable is a torch term."""
    return isinstance(func, wp.Function)


def terms_of(cfg: object) -> dict[str, object]:
    """Fields of a config, or items of a dict, by name; an empty dict for None."""
    if cfg is None:
        return {}
    if isinstance(cfg, Mapping):
        return dict(cfg)
    return {name: getattr(cfg, name) for name in getattr(cfg, "__dataclass_fields__", ())}


def with_terms(cfg: object, terms: Mapping[str, object]) -> object:
    """A config or dict with other terms; ``cfg`` itself, which is written to files, stays as it is."""
    before = terms_of(cfg)
    if all(term is before[name] for name, term in terms.items()):
        return cfg
    if isinstance(cfg, Mapping):
        return {**cfg, **terms}
    made = copy.copy(cfg)
    vars(made).update(terms)
    return made


class ManagerBase:
    """Base of managers: terms of one kind, turned into the items of a step.

    Methods that end in ``_items`` give the items of a step. The others answer and act between steps.

    Attributes:
        cfg: Config or dict of the terms; of a class term it has the instance.
        context: Arrays, names, parameters and structs that the managers of an environment share.
    """

    name: ClassVar[str] = ""
    """Name of the field of the environment's config that has the terms."""

    def __init__(self, cfg: object, context: ManagerContext):
        self.cfg, self.context = cfg, context
        self._outside = OutsideStep(context)
        self._instances: dict[str, HasReset] = {}
        """Instances of class terms, and of other classes of the user that begin anew with each episode, by path."""

    @property
    def active_terms(self) -> Sequence[str] | Mapping[str, list[str]]:
        """Names of the terms; by group for observations."""
        return []

    def find_terms(self, name_keys: str | Sequence[str]) -> list[str]:
        """Names of the terms that match regular expressions, those of all groups together.

        Raises:
            ValueError: an expression matches nothing.
        """
        active = self.active_terms
        names = [n for group in active.values() for n in group] if isinstance(active, Mapping) else list(active)
        return match_names(name_keys, names, what=f"term of '{self.name}'")[1]

    def terms(self, cfg: object, kind: type[Term], path: str | None = None) -> dict[str, Term]:
        """The terms of a config or dict by name, without those that are None.

        Terms of another type and terms without a function are left out, and added to ``context.problems``. Of a class
        term, the config that is returned has the instance as its function.

        Args:
            cfg: Config or dict.
            kind: Class of the terms.
            path: Path of the config, for problems; by default the name of the manager.
        """
        own, path = path is None, path or self.name
        good: dict[str, Term] = {}
        for name, term in terms_of(cfg).items():
            if term is None:
                continue
            func = getattr(term, "func", None)
            if not isinstance(term, kind):
                what = type(term).__name__
                self.context.problems.append(f"{path}.{name}: is {what}, must be {kind.__name__} or None")
            elif is_config(term) and func is MISSING:
                self.context.problems.append(f"{path}.{name}.func: is missing, set the function")
            elif isinstance(func, wp.Kernel):
                text = f"is the kernel '{func.key}', must be a function: write @wp.func in place of @wp.kernel"
                self.context.problems.append(f"{path}.{name}.func: {text}")
            elif not inspect.isclass(func):
                good[name] = term
            elif issubclass(func, ManagerTermBase):
                good[name] = self._with_instance(f"{path}.{name}", term, func)
            else:
                text = f"is the class '{func.__name__}', must be a function, or a class derived from ManagerTermBase"
                self.context.problems.append(f"{path}.{name}.func: {text}")
        if own:
            self.cfg = with_terms(cfg, good)
        return good

    def _with_instance(self, path: str, term: Any, func: type[ManagerTermBase]) -> Any:
        """The config of a class term with its instance as function."""
        params = resolve_entities(term.params, self.context.scene.__getitem__)
        made = copy.copy(term)
        made.params = params
        made.func = self._instances[f"{path}.func"] = make_instance(f"{path}.func", func, made, self.context.env)
        return made

    def instance_states(self) -> list[dict[str, Any]]:
        """Attributes of class terms, of which the tensors are part of the environment's state."""
        return [vars(term) for term in self._instances.values()]

    def reset_instance_items(self) -> list[Item]:
        """The item that resets class terms where an episode begins; none where no class has a ``reset``."""
        own = [term for term in self._instances.values() if has_own_reset(term)]
        indices = self.context.reset_mask.indices

        def run() -> None:
            env_ids = indices()
            if len(env_ids):
                for term in own:
                    term.reset(env_ids)

        names = [type(term).__name__ for term in own]
        return [HostFunction(f"{self.name}_reset", run, "class terms", names)] if own else []

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
        """A table in plain text."""
        cells = [list(map(str, columns)), *([str(c) for c in row] for row in rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
        lines = ["  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join([title, lines[0], "-" * max(map(len, lines)), *lines[1:]])
