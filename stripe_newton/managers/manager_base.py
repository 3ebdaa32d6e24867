# SPDX-License-Identifier: Apache-2.0
"""What all managers have in common."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import warp as wp

from stripe_newton.configclass import MISSING, is_config
from stripe_newton.fusion import resolve_entities

from .context import ManagerContext

__all__ = ["ManagerBase", "is_warp_term"]


def is_warp_term(func: Any) -> bool:
    """Whether a term is a Warp function; any other callable is a torch term."""
    return isinstance(func, wp.Function)


class ManagerBase:
    """Terms of one kind. A manager turns them into the items of a step; it computes nothing on the host."""

    name: ClassVar[str] = ""
    """Field of the environment's config that it is made of."""

    def __init__(self, cfg: Any, context: ManagerContext):
        self.cfg, self.context = cfg, context

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return []

    def terms(self, cfg: Any, kind: type, path: str | None = None) -> dict[str, Any]:
        """The terms of a config or dict by name, without those that are None; wrong ones become problems."""
        path = path or self.name
        if cfg is None:
            return {}
        found = dict(cfg) if isinstance(cfg, dict) else {k: getattr(cfg, k) for k in cfg.__dataclass_fields__}
        good = {}
        for name, term in found.items():
            if term is None:
                continue
            if not isinstance(term, kind):
                what = type(term).__name__
                self.context.problems.append(f"{path}.{name}: is {what}, must be {kind.__name__} or None")
            elif is_config(term) and getattr(term, "func", None) is MISSING:
                self.context.problems.append(f"{path}.{name}.func: is missing, set the function")
            elif inspect.isclass(func := getattr(term, "func", None)):
                text = f"is the class '{func.__name__}', must be a function, such as a method of an instance of it"
                self.context.problems.append(f"{path}.{name}.func: {text}")
            else:
                good[name] = term
        return good

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
        """A table in plain text."""
        cells = [list(map(str, columns)), *([str(c) for c in row] for row in rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
        lines = ["  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
        return "\n".join([title, lines[0], "-" * max(map(len, lines)), *lines[1:]])

    def torch_term(self, func: Callable[..., Any], params: dict[str, Any]) -> Callable[[], Any]:
        """A torch term as a call without arguments."""
        given = resolve_entities(params, self.context.scene.__getitem__)
        return lambda: func(self.context.owner, **given)
