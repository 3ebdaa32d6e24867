# SPDX-License-Identifier: Apache-2.0
"""Term manager: base of managers whose terms are functions by name, with configs that may change at run time."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import torch
import warp as wp

from stripe_newton.call_checks import described
from stripe_newton.fusion import SceneEntityCfg, resolve_entities

from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term, with_terms

__all__ = ["TermManager", "TorchCall"]


class HasParams(Protocol):
    """Config of a term: its function and the function's parameters."""

    params: dict[str, Any]

    @property
    def func(self) -> Callable[..., object]:
        """Function of the term."""
        ...


Cfg = TypeVar("Cfg", bound=HasParams)


class TorchCall:
    """A torch term with its parameters, both of which may be replaced.

    Attributes:
        function: The function, or the instance of a class term.
        params: Its parameters, with the joints and bodies of each :class:`SceneEntityCfg` as indices.
    """

    def __init__(self, context: ManagerContext, cfg: HasParams):
        self._context = context
        self.set(cfg)

    def set(self, cfg: HasParams) -> None:
        """Take function and parameters of a config."""
        self.function, self.params = cfg.func, resolve_entities(cfg.params, self._context.scene.__getitem__)

    def __call__(self, *args: object) -> Any:
        """Call the term with the environment, further arguments, and the parameters."""
        return self.function(self._context.owner, *args, **self.params)

    def number_per_env(self, path: str) -> torch.Tensor | float:
        """Call the term, which must return real numbers, shape ``(num_envs,)``, or one plain number for all.

        Args:
            path: Path of the term, for the message.

        Raises:
            ValueError: if it returns something else.
        """
        value = self()
        if isinstance(value, torch.Tensor):
            # A tensor of one number for all is refused: it is nearly always a sum or mean that lacks its dimension.
            is_right = tuple(value.shape) == (self._context.num_envs,) and not value.is_complex() and not value.is_meta
        else:
            is_right = isinstance(value, (bool, int, float))
        if not is_right:
            hint = ", as by torch.sum(..., dim=1)" if isinstance(value, torch.Tensor) and value.dim() != 1 else ""
            must = f"one number for each environment, shape ({self._context.num_envs},){hint}"
            raise ValueError(f"{path}: '{_name(self.function)}' returned {described(value)}, must return {must}")
        return value

    def problem(self, extra: int) -> str | None:
        """Why the function cannot be called with the environment, ``extra`` arguments and its parameters, or None."""
        try:
            signature = inspect.signature(self.function)
        except (TypeError, ValueError):  # functions in C have none
            return None
        try:
            signature.bind(*[None] * (1 + extra), **self.params)
        except TypeError as error:
            given = ["the environment", *["env_ids"] * extra, *self.params]
            return f"'{_name(self.function)}{signature}' is called with {', '.join(given)}: {error}"
        return None


class TermManager(ManagerBase, Generic[Cfg]):
    """Base of managers whose config has a function for each term.

    :meth:`set_term_cfg` changes a term between steps. A torch term takes any function and parameters; a Warp term takes
    new numbers, as these are parameters on the device, but no other function, joints or bodies.
    """

    FIXED: ClassVar[tuple[str, ...]] = ()
    """Fields of a term's config that cannot change."""
    TORCH_ARGUMENTS: ClassVar[int] = 0
    """Arguments of a torch term between the environment and its parameters, such as ``env_ids``."""

    def __init__(self, cfg: object, context: ManagerContext, kind: type[Cfg]):
        """Read the terms, which are configs of class ``kind``."""
        super().__init__(cfg, context)
        self._terms: dict[str, Cfg] = self.terms(cfg, kind)
        self._calls: dict[str, TorchCall] = {}
        self._bound = {name: self._bindings(term) for name, term in self._terms.items()}

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    def get_term_cfg(self, term_name: str) -> Cfg:
        """Config of a term. Changes of it take effect by :meth:`set_term_cfg`.

        Raises:
            KeyError: if there is no such term.
        """
        if term_name not in self._terms:
            raise KeyError(f"{self.name}: no term '{term_name}'; there is {', '.join(self._terms) or 'none'}")
        return self._terms[term_name]

    def set_term_cfg(self, term_name: str, cfg: Cfg) -> None:
        """Change the config of a term, from the next step on.

        Raises:
            KeyError: if there is no such term.
            ValueError: for a change that cannot be made while the environment runs.
        """
        self.get_term_cfg(term_name)
        path, fixed = f"{self.name}.{term_name}", self._fixed_changes(term_name, cfg)
        if fixed:
            raise ValueError(
                f"{path}: {', '.join(fixed)} cannot change while the environment runs; of a Warp term only numbers can"
            )
        if not is_warp_term(cfg.func) and (problem := TorchCall(self.context, cfg).problem(self.TORCH_ARGUMENTS)):
            raise ValueError(f"{path}.func: {problem}")
        self._terms[term_name] = cfg
        self.cfg = with_terms(self.cfg, {term_name: cfg})
        self._set_numbers(path, vars(cfg))
        if is_warp_term(cfg.func):
            self._set_numbers(path, cfg.params)
        else:
            self.call(term_name).set(cfg)
        self._bound[term_name] = self._bindings(cfg)

    def call(self, name: str) -> TorchCall:
        """The call of a torch term, which follows :meth:`set_term_cfg`."""
        if name not in self._calls:
            self._calls[name] = call = TorchCall(self.context, self._terms[name])
            if problem := call.problem(self.TORCH_ARGUMENTS):
                self.context.problems.append(f"{self.name}.{name}.func: {problem}")
        return self._calls[name]

    def _set_numbers(self, path: str, values: Mapping[str, Any]) -> None:
        parameters = self.context.parameters
        for key, value in values.items():
            if f"{path}.{key}" in parameters and value is not None:
                parameters[f"{path}.{key}"] = value

    def _fixed_changes(self, name: str, cfg: Cfg) -> list[str]:
        """Fields and parameters of a config that differ from what the term was bound to, and are no numbers."""
        before, now = self._bound[name], self._bindings(cfg)
        changed = [k for k in self.FIXED if not _same(before[k], now[k])]
        if not is_warp_term(before["func"]) and not is_warp_term(cfg.func):
            return changed
        if before["func"] is not cfg.func:
            changed.append("func")
        old, new = before["params"], now["params"]
        names = [k for k in {**old, **new} if not _same(old.get(k), new.get(k))]
        return changed + [f"params.{k}" for k in names if f"{self.name}.{name}.{k}" not in self.context.parameters]

    def _bindings(self, cfg: Cfg) -> dict[str, Any]:
        """Function, parameters and fixed fields of a bound term; copies, as configs may be changed in place."""
        params = {k: v.replace() if isinstance(v, SceneEntityCfg) else v for k, v in cfg.params.items()}
        return {"func": cfg.func, "params": params} | {k: getattr(cfg, k) for k in self.FIXED}


def _name(function: object) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _same(a: object, b: object) -> bool:
    return a is b if isinstance(a, (torch.Tensor, wp.array)) else a is b or bool(a == b)
