# SPDX-License-Identifier: Apache-2.0
"""Custom manager: base of managers of a user's own, whose items are part of the step, fused and captured like ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import warp as wp

from stripe_newton.configclass import MISSING, configclass, is_config
from stripe_newton.fusion import Code, HostFunction, Item, Section, bind_term
from stripe_newton.fusion.warp_types import StructInstance

from .context import ManagerContext
from .manager_base import ManagerBase, terms_of

__all__ = ["CustomManager", "CustomManagerCfg", "make_custom_managers"]


class CustomManager(ManagerBase):
    """Base of managers of a user's own: fill the hooks for the times at which it takes part in a step.

    A hook returns items: sections of :meth:`call`, which are fused with those of their neighbours, or functions on the
    host by :meth:`host`. Hooks run when the environment is made, not in the step. In the order of a step:

    =====================  ==================================================================================
    ``startup_items``      once, before the first reset
    ``action_items``       after the action terms have set targets
    ``substep_items``      before each physics step (sections alone; all physics steps are then no longer one launch)
    ``physics_items``      after the physics, before terminations
    ``reward_items``       after rewards and metrics
    ``log_items``          where an episode ended, before anything is reset
    ``reset_items``        where an episode begins, after the reset events; also in ``reset()``
    ``observation_items``  before the observations; where an episode begins, of the new one; also in ``reset()``
    =====================  ==================================================================================

    Arrays of :meth:`array` are saved with the environment. Structs that are offered by :meth:`provide` can be arguments
    of terms. Values are logged by :meth:`log`.

    Attributes:
        name: Its name in the config.
        cfg: Its config.
        context: Arrays, names, parameters and structs of the environment.
        functions: Warp functions that it calls and that its config does not name. What they read decides what the
            simulation computes, so it must be known before the model is built.
    """

    functions: ClassVar[Sequence[wp.Function]] = ()
    cfg: CustomManagerCfg

    def __init__(self, name: str, cfg: CustomManagerCfg, context: ManagerContext):
        """Make the arrays; the managers of the environment's terms are made later."""
        super().__init__(cfg, context)
        self.name = name  # type: ignore[misc]  # of each instance, as there may be several

    @property
    def active_terms(self) -> list[str]:
        """Names for the description."""
        return [self.name]

    # -- hooks

    def startup_items(self) -> list[Item]:
        """Items that run once, before the first reset."""
        return []

    def action_items(self) -> list[Item]:
        """Items that run after the action terms have set targets."""
        return []

    def substep_items(self) -> list[Section]:
        """Sections that run before each physics step."""
        return []

    def physics_items(self) -> list[Item]:
        """Items that run after the physics, before terminations."""
        return []

    def reward_items(self) -> list[Item]:
        """Items that run after rewards and metrics."""
        return []

    def log_items(self) -> list[Item]:
        """Items that run where an episode ended, before anything is reset."""
        return []

    def reset_items(self) -> list[Item]:
        """Items that run where an episode begins, after the reset events."""
        return []

    def observation_items(self) -> list[Item]:
        """Items that run before the observations."""
        return []

    # -- for hooks

    def array(self, name: str, dtype: type, *shape: int, fill: float = 0) -> wp.array:
        """An array ``(num_envs, *shape)`` that lasts from step to step and is saved with the environment."""
        return self.context.array(f"managers.{self.name}.{name}", dtype, *shape, fill=fill)

    def provide(self, struct: StructInstance) -> None:
        """Offer a Warp struct to terms, by its type and the manager's name. Call it in ``__init__``."""
        self.context.provide(struct, self.name)

    def call(self, func: wp.Function, **params: object) -> Section:
        """A section that calls a Warp function for each environment.

        Args:
            func: Warp function ``(env, ...)`` that returns nothing. Its arguments are found as those of a term.
            params: Values of arguments. Numbers are parameters, ``managers.NAME.ARGUMENT``, which a curriculum may
                change.
        """
        made = bind_term(self.context, func, params, f"managers.{self.name}", "event")
        title = str(func.func.__name__)
        return Section(f"{self.name}_{title}", [made.expression()] if made is not None else [], [title])

    def log(self, key: str, value: Code | str, kind: str = "mean") -> Section:
        """A section that adds a value of each environment to the log of the step.

        Args:
            key: Key of the log, such as ``"Energy/used"``.
            value: Expression, such as ``context.code("{}[env]", context.scope.name("used", array))``.
            kind: ``"mean"`` over the environments where it runs, ``"count"`` for their sum.
        """
        return Section(f"{self.name}_log", [self.context.log.line(key, value, kind)], [key])

    def host(self, name: str, function: Callable[[], None]) -> HostFunction:
        """An item that calls a function on the host, between two graphs."""
        return HostFunction(f"{self.name}", function, f"host function of manager '{self.name}'", [name])

    def instance_states(self) -> list[dict[str, Any]]:
        """Attributes, of which the tensors are part of the environment's state."""
        return [vars(self)]

    def __str__(self) -> str:
        hooks = [n for n in _HOOKS if getattr(type(self), n) is not getattr(CustomManager, n)]
        rows = [(name.removesuffix("_items"),) for name in hooks]
        return self.table(f"Manager '{self.name}': {type(self).__name__}", ("Takes part in",), rows)


_HOOKS = [name for name in vars(CustomManager) if name.endswith("_items")]


@configclass
class CustomManagerCfg:
    """Config of a manager of a user's own. A subclass names the class and adds fields."""

    class_type: type[CustomManager] = MISSING
    """Class of the manager, made by ``class_type(name, cfg, context)``."""


def make_custom_managers(cfg: object, context: ManagerContext) -> dict[str, CustomManager]:
    """The managers of a config or dict of :class:`CustomManagerCfg`, by name, without those that are None."""
    made: dict[str, CustomManager] = {}
    for name, one in terms_of(cfg).items():
        if one is None:
            continue
        if not is_config(one) or not isinstance(one, CustomManagerCfg):
            what = f"is {type(one).__name__}, must be a CustomManagerCfg or None"
            context.problems.append(f"managers.{name}: {what}")
        else:
            made[name] = one.class_type(name, one, context)
    return made
