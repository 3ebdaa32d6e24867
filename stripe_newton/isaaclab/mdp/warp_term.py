# SPDX-License-Identifier: Apache-2.0
"""Warp terms by Isaac Lab's names and signatures.

In a config such a term stands for the Warp function below it, which a manager fuses. Called with an environment, as a
user's torch term does, it returns a tensor.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
import warp as wp

from stripe_newton.configclass import is_config
from stripe_newton.envs import RLEnv

from ..stand_ins import StandIn

__all__ = ["SettledTerm", "WarpEvent", "WarpTerm", "event_of", "term_of", "use_warp_functions"]


class SettledTerm:
    """A term of Isaac Lab that stands for one of the package in configs."""

    def settle(self, term: Any) -> None:
        """Let the config of a term have the package's function and its parameters."""
        raise NotImplementedError

    def __copy__(self) -> SettledTerm:
        return self

    def __deepcopy__(self, memo: object) -> SettledTerm:
        return self


class WarpTerm(SettledTerm):
    """A Warp term with Isaac Lab's name and signature.

    Attributes:
        function: The Warp function.
        signature: Isaac Lab's parameters after the environment, with its defaults.
    """

    _GIVEN: tuple[str, ...] = ("env",)
    """Arguments that come from the manager rather than from the config."""

    def __init__(
        self, declaration: Callable[..., object], function: wp.Function, unused: Sequence[str] = (), unless: str = ""
    ):
        """Take name, documentation and signature from a declaration.

        Args:
            declaration: Python function of Isaac Lab's name and signature.
            function: The Warp function.
            unused: Parameters of Isaac Lab that the Warp function does not have.
            unless: Parameter with which the declaration itself is the term, a torch function.
        """
        functools.update_wrapper(self, declaration)
        self.function, self._unused, self._unless = function, frozenset(unused), unless
        self._declaration = declaration
        every = inspect.signature(declaration).parameters.values()
        self.signature = inspect.Signature([p for p in every if p.name not in self._GIVEN])

    def __call__(self, env: RLEnv, *args: object, **kwargs: object) -> torch.Tensor:
        """The value of the term on the present state, in a new tensor."""
        given = self._bind(args, kwargs)
        if self._unless and given.get(self._unless) is not None:
            return self._declaration(env, **given)  # type: ignore[return-value]  # a torch term
        return env.evaluate(self.function, **self.params(given))

    def _bind(self, args: tuple[object, ...], kwargs: Mapping[str, object]) -> dict[str, Any]:
        bound = self.signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return dict(bound.arguments)

    def params(self, given: Mapping[str, object]) -> dict[str, object]:
        """The Warp function's parameters, for those of a config or call of Isaac Lab's."""
        defaults = {n: p.default for n, p in self.signature.parameters.items() if p.default is not p.empty}
        every = {**defaults, **given}
        return {k: v for k, v in every.items() if v is not None and k not in self._unused}

    def settle(self, term: Any) -> None:
        """Let the config of a term have the Warp function and its parameters."""
        if self._unless and term.params.get(self._unless) is not None:
            term.func = self._declaration
        else:
            term.func, term.params = self.function, self.params(term.params)

    def __reduce__(self) -> str:
        return self.__qualname__  # type: ignore[attr-defined]  # of the declaration, whose name it has


class WarpEvent(WarpTerm):
    """A Warp event with Isaac Lab's name and signature."""

    _GIVEN = ("env", "env_ids")

    def __call__(  # type: ignore[override]  # an event has environments and no value
        self, env: RLEnv, env_ids: Sequence[int] | torch.Tensor | None, *args: object, **kwargs: object
    ) -> None:
        """Run the event in the environments ``env_ids``; None means all of them."""
        env.apply_event(self.function, env_ids, **self.params(self._bind(args, kwargs)))


def term_of(
    function: wp.Function, unused: Sequence[str] = (), unless: str = ""
) -> Callable[[Callable[..., object]], WarpTerm]:
    """Decorator of a declaration: the arguments are those of :class:`WarpTerm`."""
    return lambda declaration: WarpTerm(declaration, function, unused, unless)


def event_of(function: wp.Function, unused: Sequence[str] = ()) -> Callable[[Callable[..., object]], WarpEvent]:
    """Decorator of a declaration of an event: the arguments are those of :class:`WarpTerm`."""
    return lambda declaration: WarpEvent(declaration, function, unused)


def use_warp_functions(cfg: object) -> None:
    """Let all terms in a config have the package's functions in the place of those of Isaac Lab, in place."""
    if isinstance(cfg, Mapping):
        parts: Sequence[object] = list(cfg.values())
    elif isinstance(cfg, (list, tuple)):
        parts = cfg
    elif is_config(cfg) and not isinstance(cfg, StandIn):
        func = vars(cfg).get("func")
        if isinstance(func, SettledTerm):
            func.settle(cfg)
        parts = list(vars(cfg).values())
    else:
        return
    for part in parts:
        use_warp_functions(part)
