# SPDX-License-Identifier: Apache-2.0
"""Wrong values of config fields, judged by ``typeguard`` and the annotations, not by the checks that are tried."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import random
import re
import typing
import warnings
from collections.abc import Iterator

from typeguard import CollectionCheckStrategy, ForwardRefPolicy, TypeCheckError, check_type

__all__ = ["Field", "all_config_classes", "fields_of", "nonfinite_value", "wrong_value"]

POOL = (
    "'text'", "''", "b'bytes'", "3", "-1", "2.5", "True", "None", "[]", "{}", "()", "[1, 2]", "(1, 2, 3, 4, 5, 6, 7)",
    "['a', 3]", "[[1]]", "{'a': 1}", "{1: 2}", "{1}", "object()", "len", "int", "1j", "[None]", "'1'", "range(3)",
    "[True]", "(None, None)", "[{}]", "Exception('x')", "float", "iter([])", "'nan'", "[object()]",
)  # fmt: skip
NUMBERS_IN_TEXT = re.compile(r"\b(float|int|PerJoint|Range|Value)\b")
INFINITE = re.compile(r"\binf|no limit|unlimited|no bound", re.IGNORECASE)
"""In the docstring of a field to which infinity means something."""


@dataclasses.dataclass(frozen=True)
class Field:
    """A field of a config class."""

    cls: type
    name: str
    hint: object
    doc: str

    @property
    def path(self) -> str:
        return f"{self.cls.__module__}:{self.cls.__qualname__}"


def all_config_classes(*packages: str) -> list[type]:
    """Config classes of all modules of some packages, by name."""
    found: dict[str, type] = {}
    for package in packages:
        root = importlib.import_module(package)
        for module in pkgutil.walk_packages(root.__path__, f"{package}."):
            if "__main__" in module.name or ".isaaclab" in module.name:
                continue
            names = vars(importlib.import_module(module.name))
            for value in list(names.values()):
                for cls in _with_nested(value):
                    found[f"{cls.__module__}:{cls.__qualname__}"] = cls
    return [found[name] for name in sorted(found)]


def _with_nested(value: object) -> Iterator[type]:
    if isinstance(value, type) and vars(value).get("__is_configclass__"):
        yield value
        for item in list(vars(value).values()):
            if isinstance(item, type) and item.__qualname__.startswith(value.__qualname__ + "."):
                yield from _with_nested(item)


def fields_of(cls: type, docs: dict[str, str]) -> list[Field]:
    """Fields of a config class whose annotations can be evaluated."""
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except Exception:  # names that exist for type checkers alone
        return []
    return [Field(cls, f.name, hints[f.name], docs.get(f.name, "")) for f in dataclasses.fields(cls) if f.name in hints]


def wrong_value(field: Field, rng: random.Random) -> str | None:
    """An expression whose value the annotation does not allow, or None if there is none.

    What a base allows is right in a subclass, too.
    """
    hints = [vars(base).get("__annotations__", {}).get(field.name) for base in field.cls.__mro__]
    if any(str(hint) == "object" for hint in hints):
        return None  # terms may also stand in a dict, which is checked when the environment is built
    is_space = any(str(hint) == "SpaceSpec" for hint in hints)
    for text in rng.sample(POOL, len(POOL)):
        value = eval(text)
        if is_space and isinstance(value, (int, list, tuple, dict, set)):
            continue  # spaces in short, most of them
        if value is None and (
            _may_be_left_out(field.hint)
            or _default(field) is None
            or "None" in str(field.hint)
            or "object" in str(field.hint)
        ):
            continue
        if not _fits(value, field.hint):
            return text
    return None


def nonfinite_value(field: Field, rng: random.Random) -> str | None:
    """An expression for a value that is not finite where a number belongs, or None if the field holds no numbers."""
    if not NUMBERS_IN_TEXT.search(str(field.hint)) or re.search("Callable|Cfg|dict|Mapping", str(field.hint)):
        return None
    bad = rng.choice(("float('nan')", "float('inf')", "float('-inf')"))
    if "inf" in bad and (INFINITE.search(field.doc) or "nfinit" in str(field.hint)):
        bad = "float('nan')"
    for shape in (f"{bad}", f"({bad}, 1.0)", f"({bad}, 0.0, 0.0)", f"(0.0, 0.0, 0.0, {bad})", f"[{bad}]"):
        if _fits(eval(shape), field.hint):
            return shape
    return bad


def _may_be_left_out(hint: object) -> bool:
    """Whether a hint names a config that a user may set to None: a term, a group of terms, an asset."""
    return bool(getattr(hint, "MAY_BE_NONE", False))


def _default(field: Field) -> object:
    found = next(f for f in dataclasses.fields(field.cls) if f.name == field.name)  # type: ignore[arg-type]
    return found.default


def _fits(value: object, hint: object) -> bool:
    """Whether a value is of a type, by typeguard; lists and tuples are one, a bool is no number."""
    return any(_is(other, hint) for other in _readings(value)) and not _is_bool_for_number(value, hint)


def _readings(value: object) -> Iterator[object]:
    yield value
    if isinstance(value, (list, tuple)):
        yield tuple(value)
        yield list(value)
        yield [tuple(item) if isinstance(item, list) else item for item in value]


def _is(value: object, hint: object) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            check_type(
                value,
                hint,
                forward_ref_policy=ForwardRefPolicy.IGNORE,
                collection_check_strategy=CollectionCheckStrategy.ALL_ITEMS,
            )
        except TypeCheckError:
            return False
        except Exception:  # a type that typeguard does not know
            return True
    return True


def _is_bool_for_number(value: object, hint: object) -> bool:
    items = value if isinstance(value, (list, tuple)) and value else [value]
    return all(isinstance(item, bool) for item in items) and not re.search(
        r"bool|object|Any\b|Callable|type", str(hint)
    )
