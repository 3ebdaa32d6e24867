# SPDX-License-Identifier: Apache-2.0
"""Config base: the protocol of configs, the marker of a missing value, the error with all problems."""

from __future__ import annotations

import copyreg
import dataclasses
import difflib
from typing import Any, ClassVar, Protocol

from typing_extensions import TypeIs

__all__ = ["MISSING", "Config", "ConfigError", "NoConfigClassError", "field_names", "is_config", "unknown_field"]

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


class NoConfigClassError(TypeError):
    """A subclass of a config class without the decorator, or with ``@dataclass`` in its place."""


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


def is_config(value: object) -> TypeIs[Config]:
    """Whether ``value`` is an instance of a config class."""
    return getattr(type(value), "__is_configclass__", False)


def field_names(obj: Config) -> list[str]:
    """Names of the fields of a config."""
    return [f.name for f in dataclasses.fields(obj)]


def unknown_field(obj: Config, name: str) -> str:
    """The text of an error about a name that is no field, with the nearest name that is one."""
    near = difflib.get_close_matches(name, field_names(obj), n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(field_names(obj)) or 'none'}"
    return f"{type(obj).__name__} has no field '{name}'; {hint}"
