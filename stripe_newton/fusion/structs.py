# SPDX-License-Identifier: Apache-2.0
"""Struct resolvers: find the structs that are arguments of terms, by type.

The type of a term's argument is a kind of struct, such as the data of an articulation, a command or a sensor. Each kind
has a resolver, registered by the module that owns the struct. The resolver knows the parameters of a term's config that
name one struct of the kind. Users' structs are offered by :meth:`StructRegistry.provide` and found in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Protocol

import warp as wp

from .scene_entity import SceneEntityCfg
from .source import Code
from .term_binding import ArgumentError, TermBinding
from .warp_types import Struct, StructInstance, name_of, struct_of

__all__ = ["NamedStructs", "ParameterReferences", "SharedStruct", "StructRegistry", "StructResolver"]


class StructResolver(Protocol):
    """Finds the struct of an argument of a term."""

    def parameters(self, argument: str) -> Sequence[str]:
        """Names of the parameters of a term's config that choose the struct of an argument."""
        ...

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source code of the argument. It takes parameters from the binding, and adds the sizes of the struct to it.

        Raises:
            ArgumentError: if there is no such struct.
        """
        ...


class SharedStruct:
    """Resolver of a struct of which an environment has only one, such as ``EpisodeData``."""

    def __init__(self, name: str, struct: StructInstance):
        self._name, self._struct = name, struct

    def parameters(self, argument: str) -> Sequence[str]:
        """No parameters, as there is nothing to choose."""
        return ()

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source code of the struct."""
        return binding.context.scope.name(self._name, self._struct)


class ParameterReferences:
    """Resolver of ``Parameter``, for terms that change a parameter.

    ``address`` is the path of any parameter; ``term_name`` names a reward, whose weight is meant.
    """

    def parameters(self, argument: str) -> Sequence[str]:
        """``term_name`` and ``address``, for an argument of any name."""
        return "term_name", "address"

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source code of the reference.

        Raises:
            ArgumentError: if the config has neither.
            KeyError: if there is no such parameter.
        """
        term, address = binding.take("term_name"), binding.take("address")
        if term is None and address is None:
            raise ArgumentError("is missing, name a reward by 'term_name' or any parameter by 'address'")
        reference = binding.context.parameters.reference(str(address or f"rewards.{term}.weight"))
        return binding.context.scope.name(f"{binding.where}_{argument}", reference)


class NamedStructs:
    """Resolver of structs of one type by name.

    A config names a struct by ``<argument>``, ``<argument>_name`` or ``<argument>_cfg``, or by a parameter for all
    arguments of the type, such as ``command_name``. It may be left out if there is only one struct of the type.
    """

    def __init__(self, kind: Struct, parameters: Sequence[str] = ()):
        """``parameters`` name the struct for an argument of any name."""
        self._kind, self._common = kind, tuple(parameters)
        self.structs: dict[str, StructInstance] = {}
        """The structs by name."""
        self._counts: dict[str, Mapping[str, int]] = {}

    def add(self, name: str, struct: StructInstance, counts: Mapping[str, int] | None = None) -> None:
        """Offer a struct to terms.

        Args:
            name: Its name.
            struct: The struct.
            counts: Numbers on which sizes of observations depend, such as ``{"num_command": 3}``.
        """
        self.structs[name] = struct
        self._counts[name] = counts or {}

    def parameters(self, argument: str) -> Sequence[str]:
        """Names of the parameters that choose a struct for an argument; the first one in a config is used."""
        return (argument, f"{argument}_name", f"{argument}_cfg", *self._common)

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source code of the struct that the config names, or of the default one.

        Raises:
            ArgumentError: if there is none of that name.
        """
        cfg = binding.take_entity(*self.parameters(argument))
        name = cfg.name if cfg is not None else self.default(binding)
        if name is None or name not in self.structs:
            asked = "is missing" if name is None else f"is '{name}'"
            raise ArgumentError(
                f"{asked}, must name a {name_of(self._kind)}: {', '.join(self.structs) or 'none there'}"
            )
        binding.counts |= self._counts[name]
        self.chosen(binding, cfg or SceneEntityCfg(name))
        return binding.context.scope.name(name, self.structs[name])

    def default(self, binding: TermBinding) -> str | None:
        """Name of the struct for a config that names none; None if the config must name one."""
        return next(iter(self.structs)) if len(self.structs) == 1 else None

    def chosen(self, binding: TermBinding, cfg: SceneEntityCfg) -> None:
        """Hook for subclasses: called with the choice, on which other arguments, such as joint indices, may depend."""


class StructRegistry:
    """The resolvers of one environment, by the type of struct."""

    def __init__(self) -> None:
        self._resolvers: dict[Struct, StructResolver] = {}

    def register(self, kind: Struct, resolver: StructResolver) -> None:
        """Register the resolver of a type of struct. It replaces an earlier one."""
        self._resolvers[kind] = resolver

    def resolver(self, kind: object) -> StructResolver | None:
        """The resolver of a type; None if none is registered."""
        return self._resolvers.get(kind)  # type: ignore[call-overload]

    def named(self, kind: Struct, make: Callable[[Struct], NamedStructs] = NamedStructs) -> NamedStructs:
        """The resolver by name of a type. The first call makes it with ``make`` and registers it."""
        resolver = self.resolver(kind)
        if resolver is None:
            resolver = make(kind)
            self.register(kind, resolver)
        assert isinstance(resolver, NamedStructs)
        return resolver

    @property
    def provided(self) -> dict[Struct, dict[str, StructInstance]]:
        """Structs that are found by name: for each type, its structs by name."""
        return {kind: r.structs for kind, r in self._resolvers.items() if isinstance(r, NamedStructs)}

    def provide(self, struct: StructInstance, name: str) -> None:
        """Offer a struct to terms, by its type and a name."""
        self.named(struct_of(struct)).add(name, struct)

    def parameters(self, function: wp.Function) -> Iterator[str]:
        """Names of the parameters of a config that choose the structs of a function's arguments."""
        for argument, kind in function.input_types.items():
            resolver = self.resolver(kind)
            if resolver is not None:
                yield from resolver.parameters(argument)
