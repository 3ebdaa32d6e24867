# SPDX-License-Identifier: Apache-2.0
"""``@configclass``: dataclasses for configuration, with copied defaults, checks of names and conversion to YAML.

* a default that is mutable is copied for each instance;
* a public class attribute without an annotation is a field too;
* ``MISSING`` marks what the user must set;
* a name that is not a field is refused, with the nearest one that is;
* a subclass without the decorator, or with ``@dataclass`` in its place, is refused by name;
* :func:`validate` gathers every problem of a whole tree of configs and reports them at once;
* fields that exist only so that other people's configs load are named in ``IGNORED``, and setting one warns.
"""

from __future__ import annotations

import copy as _copy
import dataclasses
import enum
import functools
import inspect
import logging
import pickle
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from typing_extensions import dataclass_transform

from .config_base import MISSING, Config, ConfigError, NoConfigClassError, field_names, is_config, unknown_field
from .config_checks import check_types, validate
from .config_dicts import from_dict, resolve_name, to_dict
from .value_types import InheritedText

__all__ = [
    "MISSING",
    "Config",
    "ConfigError",
    "NoConfigClassError",
    "check_types",
    "config_with",
    "configclass",
    "from_dict",
    "is_config",
    "resolve_name",
    "to_dict",
    "validate",
]

logger = logging.getLogger(__name__)

T = TypeVar("T")
_SCALARS = (bool, int, float, complex, str, bytes, frozenset, type(None))

AnyConfig = TypeVar("AnyConfig", bound=Config)


@dataclass_transform(kw_only_default=False)
def configclass(cls: type[T]) -> type[T]:
    """Make ``cls`` a config class: a dataclass with copied defaults, unannotated fields and methods for configs.

    Instances get ``replace(**changes)``, ``copy()``, ``to_dict()``, ``from_dict(data)`` (in place) and
    ``validate()``. A class adds checks of its own by a method ``problems(self)`` that yields
    ``(field, message)`` pairs, and derived defaults by ``__post_init__``, as a dataclass does. Fields that follow from
    others only when the config is used are filled by a method ``completed(self)`` that returns a copy; the copy is
    what is checked.

    Fields without effect are declared with their reason, and a value other than the default is a warning::

        collision_group: int = 0
        IGNORED: ClassVar[dict[str, str]] = {"collision_group": "environments never collide with each other"}

    A class whose instances may get further fields names the types of their values, such as the terms of a manager::

        OPEN: ClassVar[tuple[type, ...]] = (RewardTermCfg,)

    A group whose fields are all terms of one kind takes further ones: ``cfg.rewards.upright = RewardTermCfg(...)``.

    A class whose subclasses may lack the decorator says so; they get it, with a warning::

        ADOPTS_SUBCLASSES: ClassVar[bool] = True

    A class whose annotations are not checked says so, for its own fields::

        ANNOTATIONS_ARE_HINTS: ClassVar[bool] = True

    Raises:
        TypeError: for a base that is a subclass of a config class and has no decorator, whose fields would be lost.

    Example:
        >>> @configclass
        ... class ArmCfg:
        ...     links: int = 2
        ...     masses = [0.5, 0.2]  # copied for each instance
        ...
        >>> first, second = ArmCfg(), ArmCfg(links=3)
        >>> first.masses.append(0.1)
        >>> second
        ArmCfg(links=3, masses=[0.5, 0.2])
        >>> ArmCfg(link=3)
        Traceback (most recent call last):
            ...
        TypeError: ArmCfg has no field 'link'; did you mean 'links'?
    """
    for base in cls.__mro__[1:]:
        _check_decorated(base)
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
        setattr(cls, "__post_init__", _next_post_init(cls))  # noqa: B010
    new = dataclasses.dataclass(cls)
    # Without class variables such as IGNORED: code that goes through the fields by name would take them for values.
    setattr(new, "__dataclass_fields__", {f.name: f for f in dataclasses.fields(new)})  # type: ignore[arg-type]  # noqa: B010
    methods = {"replace": _replace, "copy": _copy_config, "to_dict": to_dict, "from_dict": from_dict}
    methods |= {"validate": validate, "__setattr__": _setattr, "__init__": _checked(new.__init__)}
    methods |= {"__deepcopy__": _deepcopy, "__reduce_ex__": _reduce}
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
            kind = known.get(name, _type_of_default(value))
            own[name] = InheritedText(kind) if name in known and isinstance(kind, str) else kind
    return own


def _type_of_default(value: object) -> object:
    """The annotation of a field that has none and no base has one: no stricter than its default says."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return int | float if isinstance(value, int) else float
    plain = isinstance(value, (bool, str, bytes, list, tuple, dict, set, frozenset, enum.Enum)) or is_config(value)
    return type(value) if plain else "Any"


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
    try:
        return _copy.deepcopy(value)
    except (TypeError, _copy.Error):  # a module, a lock: it is shared, and the check of types may refuse it
        return value


def _next_post_init(cls: type) -> Callable[[object], None]:
    """``__post_init__`` of a class without one: that of the next base, which a class of several bases may have."""

    def post_init(self: object) -> None:
        following: Callable[[], None] | None = getattr(super(cls, self), "__post_init__", None)
        if following is not None:
            following()

    return post_init


# -- which classes and fields there are


def _check_decorated(cls: type) -> bool:
    """Check that a subclass of a config class has the decorator itself, or is adopted by its base.

    Returns:
        Whether it was adopted now, so that its ``__init__`` is another one.

    Raises:
        NoConfigClassError: with the name of the class.
    """
    if _is_checked(vars(cls).get("__init__")):
        return False
    base = next((b.__name__ for b in cls.__mro__[1:] if _is_checked(vars(b).get("__init__"))), None)
    if base is not None and getattr(cls, "ADOPTS_SUBCLASSES", False) and "__init__" not in vars(cls):
        logger.warning("class %s of %s has no @configclass: it is read as if it had one", cls.__name__, cls.__module__)
        configclass(cls)
        setattr(cls, "ANNOTATIONS_ARE_HINTS", getattr(cls, "ANNOTATIONS_ARE_HINTS", False))  # noqa: B010
        return True
    if base is not None:
        wrong = "has @dataclass in place of" if "__dataclass_params__" in vars(cls) else "has no"
        raise NoConfigClassError(
            f"class '{cls.__name__}' of {cls.__module__}, a subclass of {base}, {wrong} @configclass; "
            "write @configclass above it"
        )
    return False


def _is_checked(init: object) -> bool:
    return getattr(init, "is_of_configclass", False)


def _checked(init: Callable[..., None]) -> Callable[..., None]:
    """``__init__`` of a config class: it refuses classes without the decorator, and names that are no fields."""

    @functools.wraps(init)
    def __init__(self: Config, *args: object, **kwargs: object) -> None:
        if _check_decorated(type(self)):
            type(self).__init__(self, *args, **kwargs)
            return
        unknown = {name: kwargs.pop(name) for name in list(kwargs) if name not in type(self).__dataclass_fields__}
        refused = [_refusal(self, name, value) for name, value in unknown.items() if not _may_add(self, value)]
        if refused:
            raise TypeError("; ".join(refused))
        init(self, *args, **kwargs)
        for name, value in unknown.items():
            setattr(self, name, value)

    __init__.is_of_configclass = True  # type: ignore[attr-defined]
    return __init__


def _may_add(obj: Config, value: object) -> bool:
    """Whether a config may get a further field of this value."""
    return isinstance(value, _open_types(obj))


def _open_types(obj: Config) -> tuple[type, ...]:
    """Types of the values of further fields: those that the class names, or for a plain group of terms their type."""
    declared: tuple[type, ...] | None = getattr(type(obj), "OPEN", None)
    if declared is not None:
        return declared
    kinds = {_term_type(value) for value in vars(obj).values() if value is not None}
    found = [kind for kind in kinds if kind is not None]
    return tuple(found) if len(kinds) == 1 else ()


def _term_type(value: object) -> type | None:
    """The base class of a term, such as ``CommandTermCfg``; None for other values."""
    bases = [base for base in type(value).__mro__ if "MAY_BE_NONE" in vars(base)]
    return bases[-1] if bases else None


def _refusal(obj: Config, name: str, value: object) -> str:
    kinds = [kind.__name__ for kind in getattr(type(obj), "OPEN", ())]
    if not kinds:
        return unknown_field(obj, name)
    return f"{unknown_field(obj, name)}; a new field must be {' or '.join(kinds)}, is {value!r}"


def _setattr(self: Config, name: str, value: object) -> None:
    known = name.startswith("_") or name in type(self).__dataclass_fields__
    if not known and not isinstance(getattr(type(self), name, None), property):
        if not _may_add(self, value):
            kind = TypeError if hasattr(type(self), "OPEN") else AttributeError
            raise kind(_refusal(self, name, value))
        _add_field(self, name)
    elif not _is_checked(vars(type(self)).get("__init__")):
        _check_decorated(type(self))  # here, too: the __init__ of @dataclass replaces the one that checks
    object.__setattr__(self, name, _plain(value))


def _plain(value: object) -> object:
    """A number of NumPy, as of ``np.arange``, as a plain one: Warp takes no other for a size, ``is True`` no other."""
    is_number = type(value).__module__ == "numpy" and getattr(value, "shape", None) == ()
    return value.item() if is_number and value.dtype.kind in "iufb" else value  # type: ignore[attr-defined]


def config_with(cfg: AnyConfig, fields: Mapping[str, object]) -> AnyConfig:
    """A copy of a config with further fields; its class is a subclass that has them.

    Args:
        cfg: The config.
        fields: Values by name; a field that exists takes the value.

    Example:
        >>> @configclass
        ... class ArmCfg:
        ...     links: int = 2
        ...
        >>> config_with(ArmCfg(), {"grip": 0.5}).to_dict()
        {'links': 2, 'grip': 0.5}
    """
    new = _clone(cfg)
    for name, value in fields.items():
        if name not in type(new).__dataclass_fields__:
            _add_field(new, name)
        object.__setattr__(new, name, value)
    return new


def _add_field(obj: Config, name: str) -> None:
    base, names = vars(type(obj)).get("_EXTENDS", (type(obj), ()))
    object.__setattr__(obj, "__class__", _extended(base, (*names, name)))


@functools.cache
def _extended(base: type, names: tuple[str, ...]) -> type:
    """A subclass of a config class with further fields; the same one for the same names."""
    body: dict[str, object] = {"__annotations__": dict.fromkeys(names, Any), **dict.fromkeys(names)}
    body |= {"__module__": base.__module__, "__qualname__": base.__qualname__, "__doc__": base.__doc__}
    made: type = configclass(type(base.__name__, (base,), body))
    setattr(made, "_EXTENDS", (base, names))  # noqa: B010  (by which its instances are pickled)
    return made


def _reduce(self: Config, protocol: int) -> tuple[object, ...]:
    state = {name: _by_name(value) for name, value in vars(self).items()}
    return _restore, (*vars(type(self)).get("_EXTENDS", (type(self), ())), state)


def _restore(base: type, names: tuple[str, ...], state: dict[str, object]) -> object:
    """A config from what :func:`_reduce` gave."""
    new: object = object.__new__(_extended(base, names) if names else base)
    for name, value in state.items():
        object.__setattr__(new, name, _found(value))
    return new


@dataclasses.dataclass(frozen=True)
class _Named:
    """Name of a function in a pickled config."""

    name: str


def _by_name(value: object) -> object:
    """The value with the names of functions that Python cannot pickle itself, such as Warp functions.

    Raises:
        pickle.PicklingError: for a function that its module does not have under its name.
    """
    if type(value) in (list, tuple, dict):
        return _in_container(_by_name, value)
    if not callable(value) or not hasattr(value, "__wrapped__") or not hasattr(value, "__qualname__"):
        return value
    name = f"{value.__module__}:{value.__qualname__}"
    try:
        found = resolve_name(name)
    except (ImportError, AttributeError):
        found = None
    if found is not value:
        text = "is not found under that name; define it at the top of a module, so that other processes can import it"
        raise pickle.PicklingError(f"the function '{name}' {text}")
    return _Named(name)


def _found(value: object) -> object:
    """The value with the functions that names stand for."""
    if isinstance(value, _Named):
        return resolve_name(value.name)
    return _in_container(_found, value) if type(value) in (list, tuple, dict) else value


def _in_container(function: Callable[[object], object], value: Any) -> object:
    if isinstance(value, dict):
        return {key: function(item) for key, item in value.items()}
    return type(value)(map(function, value))


def _deepcopy(self: T, memo: dict[int, object]) -> T:
    return _clone(self)


# -- methods of instances


def _replace(self: AnyConfig, **changes: object) -> AnyConfig:
    """A copy with the named fields changed."""
    unknown = {name: value for name, value in changes.items() if name not in field_names(self)}
    refused = [_refusal(self, name, value) for name, value in unknown.items() if not _may_add(self, value)]
    if refused:
        raise AttributeError("; ".join(refused))
    new = _clone(self)
    for name, value in changes.items():
        setattr(new, name, value)
    return new


def _copy_config(self: T) -> T:
    """A copy that shares no mutable value with the original."""
    return _clone(self)
