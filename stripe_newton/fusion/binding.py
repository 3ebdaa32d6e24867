# SPDX-License-Identifier: Apache-2.0
"""Binding: finds the arguments of a term in its config and makes its call in generated source code.

Each argument is found by its name or its type. Whatever is wrong becomes a problem with the path of the config:

>>> from types import SimpleNamespace
>>> import warp as wp
>>> from stripe_newton.fusion import Parameters, Scope, StructRegistry, bind_term
>>> @wp.struct
... class Cart:
...     velocity: wp.array[float]
>>> @wp.func
... def too_fast(env: int, cart: Cart, limit: float) -> float:
...     return wp.max(wp.abs(cart.velocity[env]) - limit, 0.0)
>>> scope = Scope()
>>> context = SimpleNamespace(scope=scope, parameters=Parameters(scope, "cpu"), structs=StructRegistry(), problems=[])
>>> context.structs.provide(Cart(), "cart")
>>> bind_term(context, too_fast, {"limit": 2.0}, "rewards.too_fast", "reward").expression().text
'too_fast(env, cart, parameters[0])'
>>> bind_term(context, too_fast, {"limt": 2.0}, "rewards.too_fast", "reward")
>>> print(*context.problems, sep="\\n")
rewards.too_fast.params.limit: is missing, 'too_fast' needs it
rewards.too_fast.params.limt: 'too_fast' has no such argument; did you mean 'limit'?
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import warp as wp

from .parameters import ParameterKind
from .source import Code
from .structs import StructRegistry
from .term_arrays import array_argument
from .term_binding import ArgumentError, TermBinding, TermContext
from .term_call import OUT, TermCall
from .term_checks import term_problems
from .warp_types import SCALARS, Struct, name_of, struct_of

__all__ = ["BindingContext", "bind_term"]

_WITHOUT_NAN = ("rewards", "terminations", "metrics", "observations")
"""Managers whose terms compute with their numbers. To events NaN may mean that something stays as it is."""
_VECTORS = (wp.vec2, wp.vec3, wp.vec4, wp.quat)


class BindingContext(TermContext, Protocol):
    """Context of terms with the registry of structs, such as a :class:`ManagerContext`."""

    structs: StructRegistry


def bind_term(
    context: BindingContext,
    func: object,
    params: Mapping[str, object],
    where: str,
    kind: str,
    fixed: Mapping[str, Code] | None = None,
) -> TermCall | None:
    """Find each argument of a term by its type and name.

    Args:
        context: The manager context.
        func: A Warp function.
        params: Parameters of the config.
        where: Path of the term, such as ``rewards.alive``, below which its parameters are stored.
        kind: ``"observation"``, ``"reward"``, ``"termination"``, ``"event"``, ``"command"``, ``"action"``,
            ``"curriculum"``, ``"metric"`` or ``"modifier"``.
        fixed: Source code of arguments that the manager gives.

    Returns:
        The call, or None if problems have been added to ``context.problems``.
    """
    if not isinstance(func, wp.Function):
        context.problems.append(f"{where}.func: is {func!r}, must be a Warp function (@wp.func)")
        return None
    binding = TermBinding(context, func, params, where)
    arguments: dict[str, Code] = {}
    problems: list[str] = []
    for name, argument_type in func.input_types.items():
        try:
            arguments[name] = _argument(context, binding, name, argument_type, kind, fixed or {})
        except (ArgumentError, ValueError, KeyError) as error:
            problems.append(f"{where}.params.{name}: {error.args[0] if error.args else error}")
    problems = term_problems(binding, kind, problems)
    context.problems += problems
    return None if problems else TermCall(context.scope.function(func), arguments, binding.counts)


def _argument(
    context: BindingContext, binding: TermBinding, name: str, kind: Any, term_kind: str, fixed: Mapping[str, Code]
) -> Code:
    """Source code of one argument, by its name where that is enough, else by its type."""
    if name in fixed:
        return fixed[name]
    if name == "out" and term_kind == "observation":
        return OUT
    known = _context_argument(context, name) if name not in binding.params else None
    if known is not None:
        return known
    if wp.types.type_is_struct(kind):
        return _struct(context, binding, name, kind)
    if wp.types.is_array(kind):
        return array_argument(binding, name, kind)
    if kind in SCALARS or kind in _VECTORS:
        return _number(binding, name, kind)
    raise ArgumentError(f"is of type {getattr(kind, '__name__', kind)}, which no term can have")


def _context_argument(context: BindingContext, name: str) -> Code | None:
    """Source code of an argument that every environment has; None for other names."""
    if name == "env":
        return Code("env")
    if name in ("rng", "step"):
        return context.scope.name(name, context.scope.values[name])
    return context.parameters.add("step_dt", context.step_dt, float) if name == "step_dt" else None


def _struct(context: BindingContext, binding: TermBinding, name: str, kind: Struct) -> Code:
    """Source code of a struct: the one in the config, or the one that the registry finds for it."""
    given, resolver = binding.params.get(name), context.structs.resolver(kind)
    if wp.types.is_struct(given) and struct_of(given) is kind:  # the config has the struct itself rather than its name
        return context.scope.name(name, binding.take(name))
    if resolver is not None:
        return resolver.resolve(binding, name)
    if given is None:
        raise ArgumentError(f"'{binding.name}' needs a {name_of(kind)}, of which the environment has none")
    raise ArgumentError(f"is {given!r}, '{binding.name}' needs {name_of(kind)}")


def _number(binding: TermBinding, name: str, kind: ParameterKind) -> Code:
    """Source code that reads a number or vector from the parameters.

    A literal would be frozen into the kernel; a curriculum may change a parameter.
    """
    value: Any = binding.take(name)
    if value is None:
        if name not in binding.function.defaults:
            raise ArgumentError(f"is missing, '{binding.name}' needs it")
        value = binding.function.defaults[name]
    elif isinstance(value, float) and math.isnan(value) and binding.where.partition(".")[0] in _WITHOUT_NAN:
        raise ArgumentError(f"is {value!r}, must not be NaN")
    return binding.context.parameters.add(f"{binding.where}.{name}", value, SCALARS.get(kind, kind))
