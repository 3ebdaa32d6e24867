# SPDX-License-Identifier: Apache-2.0
"""Term binding: the state of a search for the arguments of one term, and what those who find them need."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import warp as wp

from .parameters import Parameters
from .scene_entity import SceneEntityCfg
from .scope import Scope
from .usage import usage_of
from .warp_types import StructInstance

__all__ = ["ArgumentError", "TermBinding", "TermContext"]


class ArgumentError(Exception):
    """An argument that cannot be found; the text says what would be right."""


class TermData(Protocol):
    """State of an asset, as far as terms read it."""

    @property
    def struct(self) -> StructInstance:
        """The state as the struct that terms take."""
        ...

    @property
    def unavailable(self) -> Mapping[str, str]:
        """Fields of the struct that may not be read, and why."""
        ...


class TermAsset(Protocol):
    """An asset that terms may be about."""

    @property
    def data(self) -> TermData:
        """Its state."""
        ...


class TermContext(Protocol):
    """What terms are bound to: names, numbers and arrays of one environment."""

    scope: Scope
    parameters: Parameters
    step_dt: float
    termination_names: list[str]
    problems: list[str]

    def entity(self, name: str) -> object:
        """An articulation, rigid object or sensor by name."""
        ...

    def asset(self, name: str) -> TermAsset:
        """An articulation or rigid object by name."""
        ...

    def entity_names(self) -> list[str]:
        """Names of the assets that terms may be about."""
        ...

    def array(self, name: str, dtype: type, *shape: int, fill: float = 0) -> wp.array:
        """An array ``(num_envs, *shape)`` that lasts from step to step."""
        ...

    def shared(self, name: str, dtype: type, *shape: int, fill: float = 0) -> wp.array:
        """An array of any shape that lasts from step to step."""
        ...

    def index_array(self, ids: list[int]) -> wp.array:
        """Indices as an array of int32."""
        ...


class TermBinding:
    """The binding of one term, which its arguments are found for one by one. Resolvers read and complete it.

    Attributes:
        context: What the term is bound to.
        function: The term.
        params: Parameters of the config.
        where: Path of the term, such as ``rewards.alive``.
        taken: Parameters that something took.
        counts: Numbers that the size of an observation may depend on.
        asset: The asset that the term is about, once an argument has named it; joints and bodies are of it by default.
        sensor: The sensor that it is about, likewise.
        chosen: Names of the joints or bodies by index argument.
    """

    def __init__(
        self,
        context: TermContext,
        function: wp.Function,
        params: Mapping[str, object],
        where: str,
    ):
        self.context, self.function, self.where = context, function, where
        self.counts: dict[str, int] = {}
        self.asset: SceneEntityCfg | None = None
        self.sensor: SceneEntityCfg | None = None
        self.chosen: dict[str, list[str]] = {}
        self.params = dict(params)
        self.taken: set[str] = set()

    @property
    def name(self) -> str:
        """Name of the term's function."""
        return str(self.function.func.__name__)

    @property
    def types(self) -> Mapping[str, object]:
        """Types of the arguments by name."""
        return self.function.input_types

    def take(self, *keys: str) -> Any:
        """The first of some parameters that the config has; None if it has none of them."""
        for key in keys:
            if key in self.params:
                self.taken.add(key)
                return self.params[key]
        return None

    def take_entity(self, *keys: str) -> SceneEntityCfg | None:
        """The first of some parameters, which names an asset, a sensor, a command or the like.

        Raises:
            ArgumentError: if it is no name.
        """
        value = self.take(*keys)
        if isinstance(value, str):
            return SceneEntityCfg(value)
        if value is not None and not isinstance(value, SceneEntityCfg):
            raise ArgumentError(f"is {value!r}, must be a SceneEntityCfg")
        return value

    def refuse(self, unavailable: Mapping[str, str], of: str) -> None:
        """Refuse a term that reads what is not there.

        Args:
            unavailable: Reason and remedy by field.
            of: What lacks those fields.

        Raises:
            ArgumentError: if the term reads or writes one of them.
        """
        for field, reason in sorted(usage_of(self.function).among(unavailable).items()):
            raise ArgumentError(f"'{self.name}' reads '{field}' of '{of}': {reason}")
