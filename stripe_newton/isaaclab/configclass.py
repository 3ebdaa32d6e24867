# SPDX-License-Identifier: Apache-2.0
"""Config classes of a user's files under the Isaac Lab dialect: an instance may be given fields that its class lacks.

Isaac Lab's tasks add assets, terms and values of their own to a config in ``__post_init__``.
"""

from __future__ import annotations

from typing import TypeVar

from stripe_newton import configclass as native

__all__ = ["configclass"]

T = TypeVar("T")


def _names(self: object) -> list[str]:
    """Names that ``dir()`` gives: fields and methods, without what the package itself keeps in the class.

    Projects go through ``dir(cfg)`` to find terms, such as rewards without weight.
    """
    fields = {*vars(self), *getattr(self, "__dataclass_fields__", ())}
    return [n for n in object.__dir__(self) if n in fields or n.startswith("__") or callable(getattr(self, n, None))]


def configclass(cls: type[T]) -> type[T]:
    """:func:`stripe_newton.configclass.configclass`, whose instances take new fields of any type.

    Subclasses may lack the decorator, and values may have other types than the class's own annotations say.
    """
    made = native.configclass(cls)
    made.__dir__ = _names  # type: ignore[method-assign]
    made.OPEN, made.ADOPTS_SUBCLASSES, made.ANNOTATIONS_ARE_HINTS = (object,), True, True  # type: ignore[attr-defined]
    return made
