# SPDX-License-Identifier: Apache-2.0
"""What is worth knowing about an episode beside its reward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Eager, Item, Section, bind_term

from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term

__all__ = ["MetricTermCfg", "MetricsManager"]


@configclass
class MetricTermCfg:
    """A quantity whose mean over the steps of an episode is logged as ``Metrics/NAME``."""

    func: Callable[..., Any] = MISSING
    """Warp function ``(env, ...) -> float``, or torch function ``(env, **params)`` that returns ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Its further arguments."""


class MetricsManager(ManagerBase):
    """Adds its terms up over an episode and logs the mean at its end."""

    name = "metrics"

    def __init__(self, cfg: Any, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, MetricTermCfg] = self.terms(cfg, MetricTermCfg)
        self._sums = context.array("metrics.sums", float, len(self._terms))
        self._name = context.scope.name("metric_sums", self._sums)
        self._steps_name = context.scope.name("metric_steps", context.array("metrics.steps", int))

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    def compute(self) -> list[Item]:
        """Items that add the values of this step."""
        items: list[Item] = []
        body = [f"{self._steps_name}[env] = {self._steps_name}[env] + 1"]
        for index, (name, term) in enumerate(self._terms.items()):
            if not is_warp_term(term.func):
                items.append(Eager("metrics", self._torch(index, term), f"torch term '{name}'", [name]))
                continue
            call = bind_term(self.context, term.func, term.params, f"metrics.{name}", "metric")
            if call is not None:
                body.append(f"{self._name}[env, {index}] += {call.expression()}  # {name}")
        return [*items, Section("metrics", body, self.active_terms)] if self._terms else []

    def reset(self) -> list[Item]:
        """Items that log the means and start anew."""
        lines = [f"steps = float(wp.max({self._steps_name}[env], 1))", f"{self._steps_name}[env] = 0"]
        for index, name in enumerate(self._terms):
            place = f"{self._name}[env, {index}]"
            lines += [self.context.log.line(f"Metrics/{name}", f"{place} / steps"), f"{place} = 0.0"]
        return [Section("metrics_log", lines, where_reset=True)] if self._terms else []

    def _torch(self, index: int, term: MetricTermCfg) -> Callable[[], None]:
        call, sums = self.torch_term(term.func, term.params), self.context.torch(self._sums)

        def add() -> None:
            sums[:, index] += call()

        return add

    def __str__(self) -> str:
        return self.table("Metrics", ("Index", "Name"), list(enumerate(self._terms)))
