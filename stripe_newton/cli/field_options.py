# SPDX-License-Identifier: Apache-2.0
"""Options of the command line for the fields of a config, made from an instance of it.

A field becomes an option if its value or its annotation is a bool, a number, a string or a sequence of those. Configs
inside configs, and dicts of them with plain keys, become nested options: ``--env.scene.num-envs 64``.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import keyword
import textwrap
import types
import typing
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Annotated, TypeAlias, TypeGuard

import tyro

from stripe_newton.configclass import MISSING, Config, ConfigError, is_config, to_dict
from stripe_newton.trusted_code import why_not_trusted
from stripe_newton.value_types import CODE, WRITTEN, TypeForm, annotation_of, has_mark, short

__all__ = ["Node", "Options", "TypeForm", "apply_options", "apply_saved", "options_of"]

Node: TypeAlias = Config | MutableMapping[str, object]
"""A config, or a dict with string keys inside one: what becomes a group of options."""
Options: TypeAlias = object
"""An instance of a dataclass that :func:`options_of` made; its fields are those of the config."""

_PLAIN = (bool, int, float, str)


def options_of(cfg: Node, name: str) -> Options:
    """An instance of a new dataclass whose fields are the settable fields of ``cfg``, nested in the same way.

    Args:
        cfg: A config, or a dict with string keys.
        name: Name of the dataclass, for messages.
    """
    return _options_type(cfg, name)()


def apply_options(cfg: Node, options: Options, path: str) -> None:
    """Write the values of ``options``, which :func:`options_of` made and tyro parsed, into ``cfg``.

    Args:
        cfg: A config, or a dict with string keys.
        options: The values.
        path: Path of ``cfg`` in messages, such as ``"env"``.

    Raises:
        ConfigError: for a name of code that is not trusted. The values may be those of somebody else's sweep.
    """
    settable = {field.name for field in dataclasses.fields(options)}  # type: ignore[arg-type]
    for name, value in _items(cfg):
        if name not in settable:
            continue
        new = getattr(options, name)
        if _is_node(value):
            apply_options(value, new, f"{path}.{name}")
        # Only values that changed: a field may have a type that its option cannot express exactly.
        elif not (value is MISSING and new is None) and new != _as_option(value):
            _check_code(cfg, name, new, f"{path}.{name}")
            _put(cfg, name, new)


def apply_saved(cfg: Config, saved: Mapping[str, object], path: str) -> list[str]:
    """Write the values of a saved config into ``cfg``.

    Values that are equal are left as they are. So is the path of a file that exists here, if the saved config has a
    path of a file of the same name that does not exist here.

    Args:
        cfg: The config.
        saved: The saved config, nested dicts of plain values.
        path: Path of ``cfg`` in messages, such as ``"env"``.

    Returns:
        Values that could not be applied, each as ``path: why``: fields that are gone, other functions and classes,
        places that were written.

    Raises:
        ConfigError: for a name of code that is not trusted.
    """
    return _apply_saved(cfg, to_dict(cfg), saved, path)


def _apply_saved(cfg: Node, now: Mapping[str, object], saved: Mapping[str, object], path: str) -> list[str]:
    leftovers: list[str] = []
    current = dict(_items(cfg))
    for name, value in saved.items():
        where = f"{path}.{name}"
        item, plain = current.get(name), now.get(name)
        if name not in current and is_config(cfg):
            leftovers.append(f"{where}: was {short(value)}, the field is no longer there")
        elif _is_node(item) and isinstance(value, Mapping) and isinstance(plain, Mapping):
            leftovers += _apply_saved(item, plain, value, where)
        elif name in current and plain == value and isinstance(plain, bool) == isinstance(value, bool):
            continue  # a truth value equals 0 or 1, but is no number
        elif _is_moved_file(item, value):
            continue  # the run was made on another machine, or the package was installed elsewhere
        elif is_config(cfg) and has_mark(annotation_of(type(cfg), name), WRITTEN):
            leftovers.append(f"{where}: was {short(value)}, which is not written again unless it is given as an option")
        elif _is_plain(value) and (item is MISSING or _is_plain(item)):
            _check_code(cfg, name, value, where)
            # YAML has no tuples: they come back as lists.
            _put(cfg, name, tuple(value) if isinstance(item, tuple) and isinstance(value, list) else value)
        else:
            leftovers.append(f"{where}: was {short(value)}, is {short(plain)}")
    return leftovers


def _check_code(cfg: Node, name: str, value: object, where: str) -> None:
    """Check that a value, which may come from anybody, names no code of somebody else.

    Raises:
        ConfigError: if it does.
    """
    kind = annotation_of(type(cfg), name) if is_config(cfg) else None
    if isinstance(value, str) and (name == "class_name" or has_mark(kind, CODE)):
        problem = why_not_trusted(value)
        if problem:
            raise ConfigError([f"{where}: {problem}"])


def _items(cfg: Node) -> list[tuple[str, object]]:
    """Names and values of the fields of a config, or keys and values of a dict."""
    if isinstance(cfg, Mapping):
        return list(cfg.items())
    return [(field.name, getattr(cfg, field.name)) for field in dataclasses.fields(cfg)]


def _put(cfg: Node, name: str, value: object) -> None:
    if isinstance(cfg, MutableMapping):
        cfg[name] = value
    else:
        setattr(cfg, name, value)


def _is_node(value: object) -> TypeGuard[Node]:
    return is_config(value) or (isinstance(value, Mapping) and all(isinstance(key, str) for key in value))


def _is_plain(value: object) -> bool:
    if isinstance(value, (list, tuple)):
        return all(_is_plain(item) for item in value)
    return value is None or isinstance(value, _PLAIN)


def _is_moved_file(mine: object, saved: object) -> bool:
    """Whether both are paths of files of one name, of which only ``mine`` exists."""
    if not (isinstance(mine, str) and isinstance(saved, str)) or Path(mine).name != Path(saved).name:
        return False
    return Path(mine).is_file() and not Path(saved).is_file()


def _as_option(value: object) -> object:
    """The default of an option; a value that is missing is None."""
    return None if value is MISSING else value


# -- from a config to a dataclass


def _options_type(cfg: Node, name: str) -> type:
    """The dataclass of the options of ``cfg``."""
    fields: list[tuple[str, TypeForm, object]] = []
    docs = _docs(type(cfg)) if is_config(cfg) else {}
    for key, value in _items(cfg):
        if not key.isidentifier() or keyword.iskeyword(key) or key.startswith("_"):
            continue
        if _is_node(value):
            nested = _options_type(value, f"{name}_{key}")
            if dataclasses.fields(nested):
                fields.append((key, nested, dataclasses.field(default_factory=nested)))
            continue
        kind = _kind(cfg, key, value)
        if kind is not None:
            default = dataclasses.field(default_factory=functools.partial(_as_option, value))
            fields.append((key, Annotated[kind, tyro.conf.arg(help=docs.get(key, ""))], default))
    return dataclasses.make_dataclass(name, fields)


def _kind(cfg: Node, name: str, value: object) -> TypeForm | None:
    """The type that tyro parses a field as, or None if the field cannot be given on a command line."""
    kind = _plain_part(annotation_of(type(cfg), name)) if is_config(cfg) else None
    if value is MISSING:
        return None if kind is None else kind | None
    if kind is not None and _fits(value, kind):
        return kind
    # No annotation, or a default of another type than it says: the type is that of the value.
    of_value = _type_of(value)
    if of_value is None or of_value is types.NoneType:
        return None
    return of_value if kind is None else kind | of_value


def _origin(kind: TypeForm) -> object:
    """The generic that a type is made of, such as ``tuple`` of ``tuple[int, int]``; None for a plain class."""
    return typing.get_origin(kind)


def _is_union(kind: TypeForm) -> bool:
    return _origin(kind) in (typing.Union, types.UnionType)  # ``Union[a, b]`` and ``a | b``


def _plain_part(kind: TypeForm) -> TypeForm | None:
    """The part of an annotation that a command line can express, or None."""
    if kind in _PLAIN or kind is types.NoneType:
        return kind
    origin, args = _origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return kind
    if origin is Annotated:
        return _plain_part(args[0])
    if _is_union(kind):
        parts = [part for part in map(_plain_part, args) if part is not None]
        return None if all(part is types.NoneType for part in parts) else typing.Union[tuple(parts)]  # noqa: UP007
    if args and (origin is tuple or origin is list):
        parts = [arg if arg is Ellipsis else _plain_part(arg) for arg in args]
        return None if None in parts else types.GenericAlias(tuple if origin is tuple else list, tuple(parts))
    return None


def _type_of(value: object) -> TypeForm | None:
    """The type of a plain value, with the types of its items; None for any other value."""
    if value is None or type(value) in _PLAIN:
        return type(value)
    if not isinstance(value, (tuple, list)) or type(value) not in (tuple, list):
        return None
    inner = {_type_of(item) for item in value}
    kind: TypeForm = float if inner == {int, float} else inner.pop() if len(inner) == 1 else None
    if kind is None:
        return None
    return (
        types.GenericAlias(list, kind) if isinstance(value, list) else types.GenericAlias(tuple, (kind,) * len(value))
    )


def _fits(value: object, kind: TypeForm) -> bool:
    """Whether a value is of a type that :func:`_plain_part` returned."""
    origin, args = _origin(kind), typing.get_args(kind)
    if _is_union(kind):
        return any(_fits(value, part) for part in args)
    if origin is typing.Literal:
        return value in args
    if origin is list:
        return isinstance(value, list) and all(_fits(item, args[0]) for item in value)
    if origin is tuple:
        return isinstance(value, tuple) and _fits_items(value, args)
    if isinstance(value, bool):  # which Python counts as an int
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def _fits_items(values: tuple[object, ...], kinds: tuple[TypeForm, ...]) -> bool:
    """Whether the items of a tuple are of the types of its annotation."""
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        return all(_fits(value, kinds[0]) for value in values)
    return len(values) == len(kinds) and all(map(_fits, values, kinds))


def _docs(cls: type) -> dict[str, str]:
    """The string below each field of a class and its bases."""
    docs: dict[str, str] = {}
    for base in reversed(cls.__mro__[:-1]):
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
        except (OSError, TypeError, SyntaxError):
            continue
        body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
        for field, text in itertools.pairwise(body):
            targets = [field.target] if isinstance(field, ast.AnnAssign) else getattr(field, "targets", [])
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                names = [target.id for target in targets if isinstance(target, ast.Name)]
                docs |= dict.fromkeys(names, " ".join(str(text.value.value).split()).replace("``", ""))
    return docs
