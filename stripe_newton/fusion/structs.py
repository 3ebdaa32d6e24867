# SPDX-License-Identifier: Apache-2.0
"""Structs that terms ask for: resolvers by type of struct, registered beside what the structs belong to.

A term says by the type of an argument which kind of struct it reads: an articulation, a command, a sensor. The resolver
of that type knows which parameters of the term's config say which one, and finds it. A struct of a user's own is
offered by :meth:`StructRegistry.provide` and found in the same way.
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
    """Finds the struct that an argument of a term stands for."""

    def parameters(self, argument: str) -> Sequence[str]:
        """Parameters of a term's config that say which struct the argument stands for."""
        ...

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the argument. Takes its parameters from the binding and tells it the counts that follow.

        Raises:
            ArgumentError: if there is no such struct.
        """
        ...


class SharedStruct:
    """A struct of which the environment has one, such as that of the episodes."""

    def __init__(self, name: str, struct: StructInstance):
        self._name, self._struct = name, struct

    def parameters(self, argument: str) -> Sequence[str]:
        """None: there is nothing to choose."""
        return ()

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the struct."""
        return binding.context.scope.name(self._name, self._struct)


class ParameterReferences:
    """A tuned number for a term that changes it: ``address`` names any, ``term_name`` the weight of a reward."""

    def parameters(self, argument: str) -> Sequence[str]:
        """``term_name`` and ``address``, whatever the argument is called."""
        return "term_name", "address"

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the reference.

        Raises:
            ArgumentError: if the config says neither.
            KeyError: if there is no such number.
        """
        term, address = binding.take("term_name"), binding.take("address")
        if term is None and address is None:
            raise ArgumentError("name what changes by 'term_name' (a reward) or 'address' (any parameter)")
        reference = binding.context.parameters.reference(str(address or f"rewards.{term}.weight"))
        return binding.context.scope.name(f"{binding.where}_{argument}", reference)


class NamedStructs:
    """Structs of one type by name. A config names one by ``<argument>``, ``<argument>_name`` or ``<argument>_cfg``,
    or by a parameter that its kind is known by, such as ``command_name``; where there is one only, it may be left out.
    """

    def __init__(self, kind: Struct, parameters: Sequence[str] = ()):
        """``parameters`` also name the struct, whatever the argument is called."""
        self._kind, self._common = kind, tuple(parameters)
        self.there: dict[str, StructInstance] = {}
        """The structs by name."""
        self._counts: dict[str, Mapping[str, int]] = {}

    def add(self, name: str, struct: StructInstance, counts: Mapping[str, int] | None = None) -> None:
        """Offer a struct.

        Args:
            name: Its name.
            struct: The struct.
            counts: Numbers that sizes of observations depend on, such as ``{"num_command": 3}``.
        """
        self.there[name] = struct
        self._counts[name] = counts or {}

    def parameters(self, argument: str) -> Sequence[str]:
        """The parameters that name a struct for an argument, the most special first."""
        return (argument, f"{argument}_name", f"{argument}_cfg", *self._common)

    def resolve(self, binding: TermBinding, argument: str) -> Code:
        """Source of the struct that the config names, or of the default one.

        Raises:
            ArgumentError: if there is none of that name.
        """
        cfg = binding.take_entity(*self.parameters(argument))
        name = cfg.name if cfg is not None else self.default(binding)
        if name is None or name not in self.there:
            asked = "is missing" if name is None else f"is '{name}'"
            raise ArgumentError(f"{asked}, must name a {name_of(self._kind)}: {', '.join(self.there) or 'none there'}")
        binding.counts |= self._counts[name]
        self.chosen(binding, cfg or SceneEntityCfg(name))
        return binding.context.scope.name(name, self.there[name])

    def default(self, binding: TermBinding) -> str | None:
        """Name of the struct where the config names none; None if it must."""
        return next(iter(self.there)) if len(self.there) == 1 else None

    def chosen(self, binding: TermBinding, cfg: SceneEntityCfg) -> None:
        """Called with what was chosen; for kinds of structs that other arguments depend on."""


class StructRegistry:
    """The resolvers of one environment, by the type of struct."""

    def __init__(self) -> None:
        self._resolvers: dict[Struct, StructResolver] = {}

    def register(self, kind: Struct, resolver: StructResolver) -> None:
        """Let a resolver find the structs of a type; it replaces the one before."""
        self._resolvers[kind] = resolver

    def resolver(self, kind: object) -> StructResolver | None:
        """The resolver of the type of an argument; None for a type that none is registered for."""
        return self._resolvers.get(kind)  # type: ignore[call-overload]

    def named(self, kind: Struct, make: Callable[[Struct], NamedStructs] = NamedStructs) -> NamedStructs:
        """The resolver by name of a type, made and registered where it is asked for the first time."""
        there = self.resolver(kind)
        if there is None:
            there = make(kind)
            self.register(kind, there)
        assert isinstance(there, NamedStructs)
        return there

    @property
    def provided(self) -> dict[Struct, dict[str, StructInstance]]:
        """Structs that are found by name, by type and name."""
        return {kind: r.there for kind, r in self._resolvers.items() if isinstance(r, NamedStructs)}

    def provide(self, struct: StructInstance, name: str) -> None:
        """Offer a struct to terms, by its type and a name."""
        self.named(struct_of(struct)).add(name, struct)

    def parameters(self, function: wp.Function) -> Iterator[str]:
        """Parameters of a config that say which structs the arguments of a function stand for."""
        for argument, kind in function.input_types.items():
            resolver = self.resolver(kind)
            if resolver is not None:
                yield from resolver.parameters(argument)
