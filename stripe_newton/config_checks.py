# SPDX-License-Identifier: Apache-2.0
"""Config checks: every problem of a whole tree of configs at once, types first, then what the classes check."""

from __future__ import annotations

import functools
import typing
import warnings
from collections.abc import Iterator, Mapping
from typing import TypeAlias

from .config_base import MISSING, Config, ConfigError, field_names, is_config
from .value_types import annotations_of, value_type

__all__ = ["check_types", "validate", "wrong_type"]

_PLAIN = (bool, int, float, str, type(None))


def validate(self: Config) -> None:
    """Check a config and all configs in it.

    A field without effect whose value is not the default gives a warning with its name.

    Raises:
        ConfigError: all fields that are ``MISSING`` or of another type than their annotation, and all problems that
            config classes report.
    """
    problems = _problems(self)
    if problems:
        raise ConfigError(problems)


def _problems(cfg: Config) -> list[str]:
    wrong = list(_wrong_types(cfg, ""))
    # What a class checks takes right types for granted, also of the configs inside it.
    broken = {id(cfg) for parents, _ in wrong for cfg in parents}
    problems = [line for _, line in wrong]
    known = {line.partition(":")[0] for line in problems}
    return problems + [line for line in _walk(cfg, "", broken) if line.partition(":")[0] not in known]


def check_types(*configs: tuple[str, Config]) -> None:
    """Check the types of all fields, before values of configs that are not complete yet are used.

    Args:
        configs: Pairs of a path for the messages, such as ``"env"``, and a config.

    Raises:
        ConfigError: all problems, if one of them is a field of another type than its annotation.
    """
    if any(True for _, cfg in configs for _ in _wrong_types(cfg, "")):
        raise ConfigError([f"{path}.{line}" for path, cfg in configs for line in _problems(cfg)])


# -- types


def wrong_type(cfg: Config, name: str, value: object) -> str | None:
    """Problem of a value by its field's annotation; None if it fits, or is the field's default."""
    cls = type(cfg)
    kinds = annotations_of(cls, name, binding=True)
    if not kinds or value is MISSING or _is_default(cls, name, value):
        return None
    if getattr(type(value), "FITS_ANY_TYPE", False):  # it reports itself where it is not supported
        return None
    if value is None and _may_be_left_out(kinds[0]):
        return None
    if any(_are_related(type(value), kind) for kind in kinds):
        return None
    # What a base allows is right in a subclass, too: a term by name in a dict, where its annotation names a config.
    return None if any(value_type(kind).fits(value) for kind in kinds) else value_type(kinds[0]).problem(value)


def _are_related(cls: type, kind: object) -> bool:
    """Whether a config may take the place of another kind: an action term that of an action term, a shape of a shape.

    A task names the class of its own term, and users put other classes there; the base of both says what fits.
    """
    for part in (kind, *typing.get_args(kind)):
        roots = [base for base in getattr(part, "__mro__", ()) if "__is_configclass__" in vars(base)]
        if roots and issubclass(cls, roots[-1]):
            return True
    return False


def _is_default(cls: type[Config], name: str, value: object) -> bool:
    """Whether a plain value is the default of the field, whatever its annotation says."""
    default = cls.__dataclass_fields__[name].default
    return isinstance(value, _PLAIN) and type(value) is type(default) and (value is default or value == default)


@functools.cache
def _may_be_left_out(kind: object) -> bool:
    """Whether an annotation names a config that may be left out, as a term or an asset."""
    return any(getattr(part, "MAY_BE_NONE", False) for part in (kind, *typing.get_args(kind)))


_Wrong: TypeAlias = tuple[tuple[Config, ...], str]
"""A value of a wrong type: the configs around it, and a line of text."""


def _wrong_types(value: object, path: str, parents: tuple[Config, ...] = ()) -> Iterator[_Wrong]:
    """Values of wrong types."""
    if is_config(value):
        around = (*parents, value)
        ignored = _ignored_fields(type(value))  # they have no effect, whatever is in them; a warning says so
        for name in [name for name in field_names(value) if name not in ignored]:
            item = getattr(value, name)
            problem = wrong_type(value, name, item)
            if problem is not None:
                yield around, f"{path}{name}: {problem}"
            else:
                yield from _wrong_types(item, f"{path}{name}.", around)
    else:
        for key, item in _items(value):
            yield from _wrong_types(item, f"{path}{key}.", parents)


@functools.cache
def _ignored_fields(cls: type) -> frozenset[str]:
    """Fields without effect, of a class and its bases."""
    return frozenset(name for base in cls.__mro__ for name in vars(base).get("IGNORED", {}))


def _items(value: object) -> Iterator[tuple[object, object]]:
    """Items of a container that may hold configs, with the names that they have in a path."""
    if isinstance(value, Mapping):
        yield from value.items()
    elif isinstance(value, (list, tuple)):
        yield from enumerate(value)


# -- what the classes check


def _walk(value: object, path: str, broken: set[int], is_complete: bool = True) -> Iterator[str]:
    """Problems of a config and of those in it.

    Args:
        value: The config, or a container that may hold some.
        path: Its path, with a dot at the end.
        broken: Configs with a value of a wrong type in them.
        is_complete: Whether what is missing was set by the configs around it. One that is broken cannot do that, so
            what is missing in it is not reported until that is mended.
    """
    if not is_config(value):
        for key, item in _items(value):
            yield from _walk(item, f"{path}{key}.", broken, is_complete)
        return
    is_broken = id(value) in broken
    if hasattr(value, "completed"):
        is_complete = is_complete and not is_broken
        value = value if is_broken else value.completed()
    if not is_broken:
        _warn_of_ignored(value)
    missing = [name for name in field_names(value) if getattr(value, name) is MISSING]
    if is_complete:
        yield from (f"{path}{name}: is missing, {type(value).__name__} needs a value" for name in missing)
    yield from _own_problems(value, path, is_broken or bool(missing))
    for name in field_names(value):
        yield from _walk(getattr(value, name), f"{path}{name}.", broken, is_complete)


def _own_problems(cfg: Config, path: str, may_fail: bool) -> Iterator[str]:
    """Problems that the class of a config reports."""
    try:
        for name, message in getattr(cfg, "problems", tuple)():
            yield f"{path + name if name else path.rstrip('.')}: {message}"  # no name: it is the config as a whole
    except Exception:  # a check may fail on a value that is missing or wrong, which has been reported already
        if not may_fail:
            raise


def _warn_of_ignored(config: Config) -> None:
    """Warn of each field that has been set and has no effect. Python shows equal warnings from one place once."""
    seen: set[str] = set()
    for cls in type(config).__mro__:
        shown = type(config).__name__ if cls.__name__.startswith("_") else cls.__name__  # not a private base
        for name, reason in vars(cls).get("IGNORED", {}).items():
            field = cls.__dataclass_fields__[name]  # type: ignore[attr-defined]
            default = field.default if field.default_factory is MISSING else field.default_factory()
            if name not in seen and getattr(config, name) != default:
                warnings.warn(f"{shown}.{name} has no effect: {reason}", stacklevel=2)
            seen.add(name)
