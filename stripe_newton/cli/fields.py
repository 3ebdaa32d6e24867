# SPDX-License-Identifier: Apache-2.0
"""Options of the command line for the fields of a config, made from an instance of it.

A field becomes an option if it holds, or may hold by its annotation, a bool, number, string or a sequence of those.
Configs inside configs, and dicts of them with plain keys, become nested options: ``--env.scene.num-envs 64``.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import itertools
import keyword
import sys
import textwrap
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from stripe_newton.configclass import MISSING, is_config, to_dict

__all__ = ["apply_options", "apply_saved", "options_of"]

_PLAIN = (bool, int, float, str)


def options_of(cfg: Any, name: str) -> Any:
    """A dataclass instance with the settable fields of ``cfg`` as its defaults, nested as they are.

    Args:
        cfg: a config, or a dict with string keys.
        name: name of the dataclass, for messages.
    """
    return _options_type(cfg, name)()


def apply_options(cfg: Any, options: Any) -> None:
    """Write the values of ``options``, which :func:`options_of` made and tyro parsed, into ``cfg``."""
    for name, value in _items(cfg):
        if not hasattr(options, name):
            continue
        new = getattr(options, name)
        if dataclasses.is_dataclass(new):
            apply_options(value, new)
        elif not (value is MISSING and new is None) and new != _as_option(value):
            _put(cfg, name, new)


def apply_saved(cfg: Any, saved: Mapping[str, Any], path: str) -> list[str]:
    """Write the values of a saved config, a nested dict, into ``cfg``; values that are equal are left as they are, as
    are files that the saved config names elsewhere, where they are not, and that are here.

    Returns:
        What could not be applied, each as ``path: why``: fields that are gone, functions and classes that are others.
    """
    return _apply_saved(cfg, to_dict(cfg), saved, path)


def _apply_saved(cfg: Any, now: Mapping[str, Any], saved: Mapping[str, Any], path: str) -> list[str]:
    leftovers: list[str] = []
    current = dict(_items(cfg))
    for name, value in saved.items():
        where = f"{path}.{name}"
        item = current.get(name)
        if name not in current and is_config(cfg):
            leftovers.append(f"{where}: was {value!r}, the field is no longer there")
        elif _is_node(item) and isinstance(value, Mapping):
            leftovers += _apply_saved(item, now[name], value, where)
        elif name in current and now[name] == value:
            continue
        elif _is_moved_file(item, value):
            continue  # the run was made on another machine, or the package was installed elsewhere
        elif _is_plain(value) and (item is MISSING or _is_plain(item)):
            _put(cfg, name, tuple(value) if isinstance(item, tuple) and isinstance(value, list) else value)
        else:
            leftovers.append(f"{where}: was {value!r}, is {now.get(name)!r}")
    return leftovers


def _items(cfg: Any) -> list[tuple[str, Any]]:
    if is_config(cfg):
        return [(field.name, getattr(cfg, field.name)) for field in dataclasses.fields(cfg)]
    return list(cfg.items())


def _put(cfg: Any, name: str, value: Any) -> None:
    if is_config(cfg):
        setattr(cfg, name, value)
    else:
        cfg[name] = value


def _is_node(value: Any) -> bool:
    return is_config(value) or (isinstance(value, Mapping) and all(isinstance(key, str) for key in value))


def _is_plain(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return all(_is_plain(item) for item in value)
    return value is None or isinstance(value, _PLAIN)


def _is_moved_file(mine: Any, saved: Any) -> bool:
    """Whether both are files of one name, of which only mine is there."""
    if not (isinstance(mine, str) and isinstance(saved, str)) or Path(mine).name != Path(saved).name:
        return False
    return Path(mine).is_file() and not Path(saved).is_file()


def _as_option(value: Any) -> Any:
    return None if value is MISSING else value


def _options_type(cfg: Any, name: str) -> type:
    fields: list[tuple[str, Any, Any]] = []
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


def _kind(cfg: Any, name: str, value: Any) -> Any:
    """The type tyro shall parse a field as, or None if it cannot be given on a command line."""
    kind = _plain_part(_annotation(type(cfg), name)) if is_config(cfg) else None
    if value is MISSING:
        return None if kind is None else kind | None
    if kind is not None and _fits(value, kind):
        return kind
    of_value = _type_of(value)
    if of_value is None or of_value is types.NoneType:
        return None
    return of_value if kind is None else kind | of_value


def _plain_part(kind: Any) -> Any:
    """What of an annotation a command line can say, or None."""
    if kind in _PLAIN or kind is types.NoneType:
        return kind
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        return kind
    if origin is Annotated:
        return _plain_part(args[0])
    if origin in (typing.Union, types.UnionType):
        parts = [part for part in map(_plain_part, args) if part is not None]
        return None if all(part is types.NoneType for part in parts) else typing.Union[tuple(parts)]  # noqa: UP007
    if origin in (tuple, list) and args:
        parts = [arg if arg is Ellipsis else _plain_part(arg) for arg in args]
        return None if None in parts else origin[tuple(parts)]
    return None


def _type_of(value: Any) -> Any:
    if value is None or type(value) in _PLAIN:
        return type(value)
    if type(value) in (tuple, list) and value:
        inner = {_type_of(item) for item in value}
        if None in inner:
            return None
        kind: Any = float if inner == {int, float} else inner.pop() if len(inner) == 1 else None
        if kind is not None:
            return (
                types.GenericAlias(list, kind)
                if type(value) is list
                else types.GenericAlias(tuple, (kind,) * len(value))
            )
    return None


def _fits(value: Any, kind: Any) -> bool:
    origin, args = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, part) for part in args)
    if origin is typing.Literal:
        return value in args
    if origin is list:
        return isinstance(value, list) and all(_fits(item, args[0]) for item in value)
    if origin is tuple:
        kinds = (args[0],) * len(value) if len(args) == 2 and args[1] is Ellipsis and isinstance(value, tuple) else args
        return isinstance(value, tuple) and len(value) == len(kinds) and all(map(_fits, value, kinds))
    return isinstance(value, (int, float) if kind is float else kind) and (kind is bool or not isinstance(value, bool))


def _annotation(cls: type, name: str) -> Any:
    """The annotation of a field, evaluated where it was written; None if that cannot be done."""
    for base in cls.__mro__:
        kind = inspect.get_annotations(base).get(name)
        if kind is None:
            continue
        if not isinstance(kind, str):
            return kind
        try:
            return eval(kind, vars(sys.modules[base.__module__]) | {"typing": typing}, dict(vars(base)))
        except Exception:  # names that exist for type checkers alone
            return None
    return None


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
