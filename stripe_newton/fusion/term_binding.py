# SPDX-License-Identifier: Apache-2.0
"""Term binding: parameters and results while the arguments of one term are found, and the interfaces used for that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import warp as wp

from .parameters import Parameters
from .scene_entity import HasNames, SceneEntityCfg
from .scope import Scope
from .usage import usage_of
from .warp_types import StructInstance

__all__ = ["ArgumentError", "TermBinding", "TermContext"]


class ArgumentError(Exception):
    """An argument that cannot be found. The text says what would be right."""


class TermData(Protocol):
    """Data of an asset that terms read."""

    @property
    def struct(self) -> StructInstance:
        """The data as the struct that terms take."""
        ...

    @property
    def unavailable(self) -> Mapping[str, str]:
        """Reasons, by field of the struct, why fields must not be read."""
        ...


class TermAsset(Protocol):
    """An articulation or rigid object, as terms use it."""

    @property
    def data(self) -> TermData:
        """Its state."""
        ...


class TermContext(Protocol):
    """Names, parameters and arrays of one environment, to which terms are bound."""

    scope: Scope
    """Names of arrays, structs and functions in generated kernels."""
    parameters: Parameters
    """Numbers that may change between steps."""
    step_dt: float
    """Duration of a step of the environment [s]."""
    termination_names: list[str]
    """Names of the termination terms."""
    problems: list[str]
    """Problems of the config so far, each as ``path: what is wrong, what would be right``."""

    def entity(self, name: str) -> HasNames:
        """An articulation, rigid object or sensor by name."""
        ...

    def asset(self, name: str) -> TermAsset:
        """An articulation or rigid object by name."""
        ...

    def entity_names(self) -> list[str]:
        """Names of the articulations and rigid objects."""
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
    """Binding of one term. Its arguments are found one by one; resolvers read it and add their results to it.

    Attributes:
        context: Names, parameters and arrays of the environment.
        function: The Warp function.
        params: Parameters of the config.
        where: Path of the term, such as ``rewards.alive``.
        taken: Names of the parameters that have been used.
        counts: Numbers on which the size of an observation may depend, such as lengths of index arrays.
        asset: The asset that an argument of the term names; ``joint_ids`` and ``body_ids`` are of it by default.
        sensor: The sensor that an argument of the term names, likewise.
        chosen: Names of the chosen joints or bodies, by index argument.
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
        """Use the first of some parameters that the config has; None if it has none of them."""
        for key in keys:
            if key in self.params:
                self.taken.add(key)
                return self.params[key]
        return None

    def take_entity(self, *keys: str) -> SceneEntityCfg | None:
        """Use the first of some parameters that the config has, as an asset, sensor, command or the like by name.

        Raises:
            ArgumentError: if it is neither a name nor a :class:`SceneEntityCfg`.
        """
        value = self.take(*keys)
        if isinstance(value, str):
            return SceneEntityCfg(value)
        if value is not None and not isinstance(value, SceneEntityCfg):
            raise ArgumentError(f"is {value!r}, must be a SceneEntityCfg")
        return value

    def check_available(self, unavailable: Mapping[str, str], of: str) -> None:
        """Raise an error if the term reads unavailable fields.

        Args:
            unavailable: Reason and remedy, by field.
            of: Name of the asset or sensor without these fields.

        Raises:
            ArgumentError: if the term reads or writes one of them.
        """
        for field, reason in sorted(usage_of(self.function).among(unavailable).items()):
            raise ArgumentError(f"'{self.name}' reads '{field}' of '{of}': {reason}")
