# SPDX-License-Identifier: Apache-2.0
"""Config dicts: a config as nested dicts of plain values, fit for YAML, and back."""

from __future__ import annotations

import enum
import importlib
import os
import re
import typing
import zlib
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NoReturn

from .config_base import MISSING, Config, ConfigError, field_names, is_config, unknown_field
from .config_checks import wrong_type
from .trusted_code import why_not_trusted
from .value_types import short

__all__ = ["from_dict", "resolve_name", "to_dict"]


def to_dict(self: Config) -> dict[str, object]:
    """Nested dicts of plain values, fit for YAML: functions and classes become ``module:name``."""
    return {name: _plain(getattr(self, name)) for name in field_names(self)}


def _plain(value: object) -> object:
    if value is MISSING:
        return "MISSING"
    if is_config(value):
        return to_dict(value)
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (set, frozenset)):
        return sorted((_plain(v) for v in value), key=repr)
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    if callable(value) and hasattr(value, "__qualname__"):
        return f"{value.__module__}:{value.__qualname__}"
    return _described(value)


def _described(value: object) -> str:
    """An object's ``repr``, or its class and a checksum of what it holds if that tells only where it lies in memory."""
    if type(value).__repr__ is not object.__repr__:
        return repr(value)
    kind = type(value)
    return f"{kind.__module__}.{kind.__qualname__}, checksum {zlib.crc32(_content(value).encode()):08x}"


def _content(value: object, depth: int = 8) -> str:
    """Text of the contents of an object, the same in each process."""
    if depth == 0 or isinstance(value, (str, bytes, int, float, type(None), enum.Enum, os.PathLike)):
        return repr(value) if depth else type(value).__qualname__
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{_content(item, depth - 1)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ",".join(_content(item, depth - 1) for item in value) + "]"
    if isinstance(value, (set, frozenset)):
        return "{" + ",".join(sorted(_content(item, depth - 1) for item in value)) + "}"
    if hasattr(value, "tobytes"):
        return value.tobytes().hex()
    if callable(value) and hasattr(value, "__qualname__"):
        return value.__qualname__
    return f"{type(value).__qualname__}{_content(getattr(value, '__dict__', None), depth - 1)}"


def from_dict(self: Config, data: Mapping[str, object]) -> None:
    """Set fields from nested dicts, in place. Fields that ``data`` does not name are not changed.

    Configs are merged, also those inside lists and dicts; other lists and dicts are replaced. ``from_dict(to_dict())``
    changes nothing. A plain value gets the type of the value that it replaces, for example a tuple from a list.

    Raises:
        ConfigError: all keys that are not fields and all values that do not fit, with their paths.
    """
    problems: list[str] = []
    _load(self, data, "", problems)
    if problems:
        raise ConfigError(problems)


def _load(obj: Config, data: Mapping[str, object], path: str, problems: list[str]) -> None:
    for name, value in data.items():
        where = f"{path}{name}"
        if name not in type(obj).__dataclass_fields__:
            problems.append(f"{where}: {unknown_field(obj, name)}")
            continue
        if isinstance(value, str) and value == "MISSING":
            continue
        old = getattr(obj, name)
        if (old is None or old is MISSING) and isinstance(value, Mapping):
            old = _new_config(obj, name) or old
        words, before = _annotation_words(type(obj).__dataclass_fields__[name].type), len(problems)
        new = _fit(old, value, words, where, problems)
        problem = None if len(problems) > before or new is old else wrong_type(obj, name, new)
        if problem is None:
            setattr(obj, name, new)
        else:
            problems.append(f"{where}: {problem}")


def _annotation_words(annotation: object) -> set[str]:
    """Names of the types that an annotation allows, without those in brackets, such as ``{"tuple", "None"}``."""
    text = re.sub(r"\b(typing\.)?(Optional|Union)\[(.*)\]", r"\3, None", str(annotation))
    while "[" in text and (shorter := re.sub(r"\[[^\[\]]*\]", "", text)) != text:
        text = shorter
    return set(re.findall(r"\w+", text))


def _fit(old: object, value: object, words: set[str], where: str, problems: list[str]) -> object:
    """:func:`_convert`; a value that does not fit is reported, and the old one returned."""
    try:
        return _convert(old, value, words, where, problems)
    except (TypeError, ValueError) as error:
        problems.append(f"{where}: {error}")
        return old


def _convert(old: object, value: object, words: set[str], where: str, problems: list[str]) -> object:
    """A plain value as the type of ``old``, or as a type that its annotation names."""
    plain = _plain(old)
    if type(value) is type(plain) and value == plain and not is_config(old):
        return old
    if is_config(old):
        if value is None and words & {"None", "NoneType", "Any"}:
            return None
        if not isinstance(value, Mapping):
            return _refuse(value, f"a mapping of {type(old).__name__}'s fields")
        _load(old, value, f"{where}.", problems)
        return old
    if isinstance(value, Mapping) and isinstance(old, Mapping):
        return _convert_mapping(old, value, where, problems)
    if isinstance(value, (list, tuple)):
        return _convert_items(old, value, words, where, problems)
    if isinstance(value, str):
        return _convert_text(old, value, words)
    return value


def _convert_mapping(
    old: Mapping[Any, object], value: Mapping[Any, object], where: str, problems: list[str]
) -> dict[Any, object]:
    new_keys = [k for k in value if k not in old] if any(map(is_config, old.values())) else []
    if new_keys:  # their config class is unknown
        raise ValueError(f"has no '{new_keys[0]}', only {', '.join(map(str, old))}; add it in Python")
    return {k: _fit(old.get(k, MISSING), v, {"Any"}, f"{where}.{k}", problems) for k, v in value.items()}


def _convert_items(
    old: object, value: Sequence[object], words: set[str], where: str, problems: list[str]
) -> Collection[object]:
    items = list(old) if isinstance(old, (list, tuple)) else []
    # Items beyond the old ones have the type of the last one.
    items += [items[-1] if items and not is_config(items[-1]) else MISSING] * (len(value) - len(items))
    new = [_fit(o, v, {"Any"}, f"{where}.{i}", problems) for i, (o, v) in enumerate(zip(items, value))]
    return _as_container(old, new, words)


def _convert_text(old: object, value: str, words: set[str]) -> object:
    if isinstance(old, enum.Enum):
        names = [member.name for member in type(old)]
        return type(old)[value] if value in names else _refuse(value, f"one of {', '.join(names)}")
    if isinstance(old, os.PathLike):
        return type(old)(value)  # type: ignore[call-arg]
    if callable(old) or (":" in value and words & {"Callable", "type"}):
        if problem := _foreign(old, value):
            raise ValueError(problem)
        try:
            return resolve_name(value)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"'{value}' cannot be imported ({error}), expected 'module:name'") from error
    return value


def _foreign(old: object, name: str) -> str:
    """Why a function or class is not resolved: it is of a module that is not trusted, nor that of the old one."""
    if name.partition(":")[0] == getattr(old, "__module__", None) not in (None, "builtins"):
        return ""
    return why_not_trusted(name)


def _as_container(old: object, items: list[object], words: set[str]) -> Any:
    if isinstance(old, (tuple, set, frozenset)):
        return type(old)(items)
    if hasattr(old, "new_tensor"):
        return old.new_tensor(items)
    if hasattr(old, "tolist") and hasattr(old, "dtype"):
        import numpy as np

        return np.asarray(items, dtype=old.dtype)
    return tuple(items) if "tuple" in words and not isinstance(old, list) else items


def _refuse(value: object, expected: str) -> NoReturn:
    raise ValueError(f"is {short(value)}, must be {expected}")


def _new_config(obj: Config, name: str) -> Config | None:
    """A default config of the class that the annotation of a field names; None if it does not name exactly one."""
    try:
        hint = typing.get_type_hints(type(obj))[name]
    except (NameError, KeyError, TypeError):
        return None
    classes = [c for c in (hint, *typing.get_args(hint)) if getattr(c, "__is_configclass__", False)]
    return classes[0]() if len(classes) == 1 else None


def resolve_name(name: str) -> Any:
    """The object that ``module:qualified.name`` names."""
    module, _, path = name.partition(":")
    if not path:
        raise ValueError("no ':' between module and name")
    value: Any = importlib.import_module(module)
    for part in path.split("."):
        value = getattr(value, part)
    return value
