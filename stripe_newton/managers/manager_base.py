# SPDX-License-Identifier: Apache-2.0
"""Manager base: terms of one kind, read from a config and turned into the items of a step."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, TypeGuard, TypeVar

import torch
import warp as wp

from stripe_newton.configclass import MISSING, is_config
from stripe_newton.fusion import resolve_entities

from .context import ManagerContext

__all__ = ["ManagerBase", "TermFunction", "is_warp_term", "terms_of"]

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


class ManagerBase:
    """Base of managers: terms of one kind, turned into the items of a step. It computes nothing on the host.

    Attributes:
        cfg: Config or dict of the terms.
        context: Arrays, names, parameters and structs that the managers of an environment share.
    """

    name: ClassVar[str] = ""
    """Name of the field of the environment's config that has the terms."""

    def __init__(self, cfg: object, context: ManagerContext):
        self.cfg, self.context = cfg, context

    @property
    def active_terms(self) -> Sequence[str] | Mapping[str, list[str]]:
        """Names of the terms; by group for observations."""
        return []

    def terms(self, cfg: object, kind: type[Term], path: str | None = None) -> dict[str, Term]:
        """The terms of a config or dict by name, without those that are None.

        Terms of another type and terms without a function are left out, and added to ``context.problems``.

        Args:
            cfg: Config or dict.
            kind: Class of the terms.
            path: Path of the config, for problems; by default the name of the manager.
        """
        path = path or self.name
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
            elif inspect.isclass(func):
                text = f"is the class '{func.__name__}', must be a function, such as a method of an instance of it"
                self.context.problems.append(f"{path}.{name}.func: {text}")
            else:
                good[name] = term
        return good

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
        """A table in plain text."""
        cells = [list(map(str, columns)), *([str(c) for c in row] for row in rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
        lines = ["  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join([title, lines[0], "-" * max(map(len, lines)), *lines[1:]])

    def torch_term(self, func: TermFunction, params: Mapping[str, object]) -> Callable[[], torch.Tensor]:
        """A torch term as a function without arguments: the environment and the params are given."""
        given = resolve_entities(params, self.context.scene.__getitem__)
        return lambda: func(self.context.owner, **given)  # type: ignore[return-value]
