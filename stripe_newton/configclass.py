# SPDX-License-Identifier: Apache-2.0
"""``@configclass``: dataclasses for configuration, with copied defaults, checks of names and conversion to YAML.

* a default that is mutable is copied for each instance;
* a public class attribute without an annotation is a field too;
* ``MISSING`` marks what the user must set;
* a name that is not a field is refused, with the nearest one that is;
* :func:`validate` gathers every problem of a whole tree of configs and reports them at once;
* fields that exist only so that other people's configs load are named in ``IGNORED``, and setting one warns.
"""

from __future__ import annotations

import copy as _copy
import copyreg
import dataclasses
import difflib
import enum
import functools
import importlib
import inspect
import os
import re
import typing
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NoReturn, Protocol, TypeVar

from typing_extensions import TypeIs, dataclass_transform

__all__ = [
    "MISSING",
    "Config",
    "ConfigError",
    "configclass",
    "from_dict",
    "is_config",
    "resolve_name",
    "to_dict",
    "validate",
]

T = TypeVar("T")
_SAME_IN_YAML = ({"bool"}, {"int", "float"}, {"str"}, {"list", "tuple"}, {"dict"})
_PLAIN_TYPES = set().union(*_SAME_IN_YAML)
_SCALARS = (bool, int, float, complex, str, bytes, frozenset, type(None))

MISSING: Any = dataclasses.MISSING
"""The value of a field that the user must set."""

# Pickling and copying return the same MISSING, as it is compared by identity.
copyreg.pickle(type(MISSING), lambda _: "MISSING")


class ConfigError(ValueError):
    """All problems of a config, each in a line ``path: what is wrong, what would be right``."""

    def __init__(self, problems: list[str]):
        """``problems``: the lines."""
        self.problems = problems
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        super().__init__(f"{count} in the configuration:\n" + "\n".join(f"  {p}" for p in problems))

    def __reduce__(self) -> tuple[type, tuple[list[str]]]:
        return type(self), (self.problems,)


class Config(Protocol):
    """A config of any class made with :func:`configclass`."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field]]

    def to_dict(self) -> dict[str, object]:
        """Nested dicts of plain values, fit for YAML."""
        ...

    def validate(self) -> None:
        """Check all fields.

        Raises:
            ConfigError: with all problems.
        """
        ...


AnyConfig = TypeVar("AnyConfig", bound=Config)


def is_config(value: object) -> TypeIs[Config]:
    """Whether ``value`` is an instance of a config class."""
    return getattr(type(value), "__is_configclass__", False)


@dataclass_transform(kw_only_default=False)
def configclass(cls: type[T]) -> type[T]:
    """Make ``cls`` a config class: a dataclass with copied defaults, unannotated fields and methods for configs.

    Instances get ``replace(**changes)``, ``copy()``, ``to_dict()``, ``from_dict(data)`` (in place) and
    ``validate()``. A class adds checks of its own by a method ``problems(self)`` that yields
    ``(field, message)`` pairs, and derived defaults by ``__post_init__``, as a dataclass does.

    Fields without effect are declared with their reason, and a value other than the default is a warning::

        collision_group: int = 0
        IGNORED: ClassVar[dict[str, str]] = {"collision_group": "environments never collide with each other"}
    """
    cls.__annotations__ = _own_fields(cls)
    inherited = getattr(cls, "__dataclass_fields__", {})
    for name, annotation in cls.__annotations__.items():
        value = vars(cls).get(name, MISSING)
        if "ClassVar" in str(annotation) or isinstance(value, dataclasses.Field):
            continue
        if name not in vars(cls) and name in inherited:  # a new annotation of an inherited field keeps its default
            value = inherited[name].default
            value = inherited[name].default_factory.value if value is MISSING else value
        factory = not isinstance(value, _SCALARS)
        setattr(cls, name, dataclasses.field(default_factory=_Default(value)) if factory else value)
    if not hasattr(cls, "__post_init__"):  # so that a subclass may call super().__post_init__()
        setattr(cls, "__post_init__", _nothing)  # noqa: B010
    new = dataclasses.dataclass(cls)
    # Without class variables such as IGNORED: code that goes through the fields by name would take them for values.
    setattr(new, "__dataclass_fields__", {f.name: f for f in dataclasses.fields(new)})  # type: ignore[arg-type]  # noqa: B010
    methods = {"replace": _replace, "copy": _copy_config, "to_dict": to_dict, "from_dict": from_dict}
    methods |= {"validate": validate, "__setattr__": _setattr, "__init__": _refuse_unknown(new.__init__)}
    for name, value in {**methods, "__is_configclass__": True}.items():
        setattr(new, name, value)
    return new


def _own_fields(cls: type) -> dict[str, object]:
    """Annotations of all fields that the body of ``cls`` declares; a field without one gets the type of its value."""
    known: dict[str, object] = {}
    for base in reversed(cls.__mro__):
        known.update(inspect.get_annotations(base))
    own = dict(inspect.get_annotations(cls))
    for name, value in vars(cls).items():
        if name not in own and _is_plain_attribute(cls, name, value):
            own[name] = known.get(name, "Any" if value is None else type(value))
    return own


def _is_plain_attribute(cls: type, name: str, value: object) -> bool:
    if name.startswith("_") or isinstance(value, (property, classmethod, staticmethod, functools.cached_property)):
        return False
    if inspect.isfunction(value) and value.__name__ == "<lambda>":
        return True
    if inspect.isfunction(value) or isinstance(value, type):  # a method or a nested class, not a value
        return not value.__qualname__.startswith(cls.__qualname__ + ".")
    return True


class _Default:
    """Default factory that returns a copy of a value; functions and classes are not copied."""

    def __init__(self, value: object):
        self.value = value

    def __call__(self) -> object:
        return _clone(self.value)


def _clone(value: Any) -> Any:
    if is_config(value):
        new = object.__new__(type(value))
        for name, item in vars(value).items():
            object.__setattr__(new, name, _clone(item))
        return new
    if value is MISSING or callable(value):
        return value
    if type(value) is dict:
        return {k: _clone(v) for k, v in value.items()}
    if type(value) in (list, tuple, set):
        return type(value)(_clone(v) for v in value)
    return _copy.deepcopy(value)


def _nothing(self: object) -> None:
    pass


def _refuse_unknown(init: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(init)
    def __init__(self: Config, *args: object, **kwargs: object) -> None:
        unknown = [_unknown(self, name) for name in kwargs if name not in type(self).__dataclass_fields__]
        if unknown:
            raise TypeError("; ".join(unknown))
        init(self, *args, **kwargs)

    return __init__


def _field_names(obj: Config) -> list[str]:
    return [f.name for f in dataclasses.fields(obj)]


def _unknown(obj: Config, name: str) -> str:
    near = difflib.get_close_matches(name, _field_names(obj), n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(_field_names(obj)) or 'none'}"
    return f"{type(obj).__name__} has no field '{name}'; {hint}"


def _setattr(self: Config, name: str, value: object) -> None:
    known = name.startswith("_") or name in type(self).__dataclass_fields__
    if known or isinstance(getattr(type(self), name, None), property):
        object.__setattr__(self, name, value)
    elif (adopt := getattr(self, "adopt_field", None)) is not None:  # a class whose instances take new fields
        adopt(name, value)
    else:
        raise AttributeError(_unknown(self, name))


def _replace(self: AnyConfig, **changes: object) -> AnyConfig:
    """A copy with the named fields changed."""
    unknown = [_unknown(self, name) for name in changes if name not in _field_names(self)]
    if unknown:
        raise AttributeError("; ".join(unknown))
    new = _clone(self)
    for name, value in changes.items():
        setattr(new, name, value)
    return new


def _copy_config(self: T) -> T:
    """A copy that shares no mutable value with the original."""
    return _clone(self)


def to_dict(self: Config) -> dict[str, object]:
    """Nested dicts of plain values, fit for YAML: functions and classes become ``module:name``."""
    return {name: _plain(getattr(self, name)) for name in _field_names(self)}


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
    return repr(value)


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
            problems.append(f"{where}: {_unknown(obj, name)}")
            continue
        if isinstance(value, str) and value == "MISSING":
            continue
        old = getattr(obj, name)
        if (old is None or old is MISSING) and isinstance(value, Mapping):
            old = _new_config(obj, name) or old
        words = _annotation_words(type(obj).__dataclass_fields__[name].type)
        setattr(obj, name, _fit(old, value, words, where, problems))


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
    _check_type(value, words)
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
        try:
            return resolve_name(value)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"'{value}' cannot be imported ({error}), expected 'module:name'") from error
    return value


def _as_container(old: object, items: list[object], words: set[str]) -> Any:
    if isinstance(old, (tuple, set, frozenset)):
        return type(old)(items)
    if hasattr(old, "new_tensor"):
        return old.new_tensor(items)
    if hasattr(old, "tolist") and hasattr(old, "dtype"):
        import numpy as np

        return np.asarray(items, dtype=old.dtype)
    return tuple(items) if "tuple" in words and not isinstance(old, list) else items


def _check_type(value: object, words: set[str]) -> None:
    """Raise an error for a plain value if the annotation names only plain types, and not its type."""
    same = next((kinds for kinds in _SAME_IN_YAML if type(value).__name__ in kinds), set())
    expected = words & _PLAIN_TYPES
    if same and expected and not words & same and words <= _PLAIN_TYPES | {"None", "NoneType", "class"}:
        _refuse(value, " or ".join(sorted(expected)))


def _refuse(value: object, expected: str) -> NoReturn:
    raise ValueError(f"got {value!r} ({type(value).__name__}), expected {expected}")


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


def validate(self: Config) -> None:
    """Check a config and all configs in it.

    A field without effect whose value is not the default gives a warning with its name.

    Raises:
        ConfigError: all fields that are ``MISSING``, and all problems that config classes report.
    """
    problems = list(_walk(self, ""))
    if problems:
        raise ConfigError(problems)


def _warn_of_ignored(config: Config) -> None:
    """Warn of each field that has been set and has no effect. Python shows equal warnings from one place once."""
    for cls in type(config).__mro__:
        for name, reason in vars(cls).get("IGNORED", {}).items():
            field = cls.__dataclass_fields__[name]  # type: ignore[attr-defined]
            default = field.default if field.default_factory is MISSING else field.default_factory()
            if getattr(config, name) != default:
                warnings.warn(f"{cls.__name__}.{name} has no effect: {reason}", stacklevel=2)


def _walk(value: object, path: str) -> Iterator[str]:
    if is_config(value):
        _warn_of_ignored(value)
        missing = [name for name in _field_names(value) if getattr(value, name) is MISSING]
        yield from (f"{path}{name}: is missing, {type(value).__name__} needs a value" for name in missing)
        try:
            yield from (f"{path}{name}: {message}" for name, message in getattr(value, "problems", tuple)())
        except (TypeError, AttributeError):  # a check may fail on a missing value, which has been reported already
            if not missing:
                raise
        for name in _field_names(value):
            yield from _walk(getattr(value, name), f"{path}{name}.")
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from _walk(item, f"{path}{key}.")
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield from _walk(item, f"{path}{index}.")
