# SPDX-License-Identifier: Apache-2.0
"""Stand-ins: objects for names of Isaac Lab that have no effect here, or that are not supported.

They load, so that the other classes of a file can be used. What they stand for follows from the spelling of the name:
a class, a function (``lower_case``) or a constant (``UPPER_CASE``).
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, ClassVar, NoReturn

from stripe_newton.configclass import configclass

__all__ = ["StandIn", "stand_in", "with_ignored_fields"]


class _Nested(type):
    """Metaclass of stand-ins: classes within a class, such as ``Cfg.InitialStateCfg``, are stand-ins too."""

    def __getattr__(cls, name: str) -> Any:
        if not name[0].isupper():
            raise AttributeError(f"{cls.__name__} has no attribute '{name}'")
        return _Nested(name, (StandIn,), {"__module__": __name__})


@dataclasses.dataclass(init=False, repr=False, eq=False)
class StandIn(metaclass=_Nested):
    """Base of stand-ins. It takes any field, and the calls that configs have. Config classes can be derived from it."""

    FITS_ANY_TYPE: ClassVar[bool] = True

    def __init__(self, *args: Any, **fields: Any):
        vars(self).update(fields)

    def __post_init__(self) -> None:
        """For configs that are derived from a stand-in and call it."""

    def replace(self, **fields: Any) -> Any:
        """A copy with other values in some fields."""
        new = self.copy()
        vars(new).update(fields)
        return new

    def copy(self) -> Any:
        """A deep copy."""
        return copy.deepcopy(self)

    def to_dict(self) -> dict[str, Any]:
        """Nothing: a stand-in has no effect."""
        return {}

    def problems(self) -> Iterator[tuple[str, str]]:
        """None; stand-ins of what is not supported override it."""
        yield from ()


StandIn.__is_configclass__ = True  # type: ignore[attr-defined]  # after the decorator: it is no field


class _AnyFields(StandIn):
    """A constant, whose fields of any name are stand-ins too: ``FRAME_MARKER_CFG.markers["frame"].scale = ...``."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = _AnyFields()
        vars(self)[name] = value
        return value

    def __getitem__(self, name: str) -> Any:
        return getattr(self, f"item {name}")

    def __setitem__(self, name: str, value: Any) -> None:
        vars(self)[f"item {name}"] = value


def stand_in(name: str, kind: str, reason: str) -> Any:
    """Stand-in for a name: a class that takes any argument, a function, or a constant.

    Args:
        name: Name in Isaac Lab.
        kind: ``"inert"`` for what has no effect. ``"refused"`` for what is not supported: a config that uses it is
            refused when it is validated, and a function raises ``NotImplementedError`` when it is called.
        reason: What is missing here, and what to use in its place.
    """
    if name.islower():
        return _function(name, kind, reason)

    def problems(self: StandIn) -> Iterator[tuple[str, str]]:
        yield "", f"{name} is not supported: {reason}"

    def __getattr__(self: StandIn, attribute: str) -> NoReturn:
        raise AttributeError(f"{name} is not supported: {reason}")

    body: dict[str, Any] = {"__doc__": f"Stand-in for Isaac Lab's ``{name}``: {reason}.", "__module__": __name__}
    if kind == "refused":
        body |= {"problems": problems, "__getattr__": __getattr__}
    if name.isupper():
        return type(name, (_AnyFields,), body)()
    return type(name, (StandIn,), body)


def _function(name: str, kind: str, reason: str) -> Any:
    def inert(*args: object, **kwargs: object) -> None:
        return None

    def refused(*args: object, **kwargs: object) -> NoReturn:
        raise NotImplementedError(f"'{name}' is not supported: {reason}")

    function = inert if kind == "inert" else refused
    function.__name__ = function.__qualname__ = name
    function.__doc__ = f"Stand-in for Isaac Lab's ``{name}``: {reason}."
    return function


@functools.cache
def with_ignored_fields(cls: type, fields: tuple[tuple[str, str], ...]) -> type:
    """A config class derived from ``cls`` that takes more fields, which have no effect and warn if they are set.

    Args:
        cls: The config class.
        fields: Name and reason of each. Those that ``cls`` has are left out.

    Returns:
        The class, always the same for equal arguments; ``cls`` itself if it has all fields.
    """
    own = getattr(cls, "__dataclass_fields__", {})
    reasons = {name: reason for name, reason in fields if name not in own}
    if not reasons:
        return cls
    body: dict[str, Any] = dict.fromkeys(reasons) | {
        "__doc__": cls.__doc__,
        "__module__": cls.__module__,
        "__qualname__": cls.__qualname__,
        "__annotations__": dict.fromkeys(reasons, object) | {"IGNORED": ClassVar[dict[str, str]]},
        "IGNORED": reasons,
    }
    return configclass(type(cls.__name__, (cls,), body))
