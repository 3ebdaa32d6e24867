# SPDX-License-Identifier: Apache-2.0
"""Metrics manager: quantities whose means over an episode are logged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import HostFunction, Item, Section, bind_term, code

from .context import ManagerContext
from .manager_base import is_warp_term
from .term_manager import TermManager

__all__ = ["MetricTermCfg", "MetricsManager", "MetricsManagerCfg"]


@configclass
class MetricTermCfg:
    """Config of a metric term: a quantity whose mean over the steps of an episode is logged as ``Metrics/NAME``."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...) -> float``, or torch function ``(env, **params)`` that returns ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""


@configclass
class MetricsManagerCfg:
    """Config of the metrics manager: a field for each term.

    Subclass it, or name them: ``MetricsManagerCfg(NAME=MetricTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (MetricTermCfg,)


class MetricsManager(TermManager[MetricTermCfg]):
    """Sums its terms over an episode and logs their means at its end."""

    name = "metrics"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context, MetricTermCfg)
        self._sums = context.array("metrics.sums", float, len(self._terms))
        self._sums_name = context.scope.name("metric_sums", self._sums)
        self._steps_name = context.scope.name("metric_steps", context.array("metrics.steps", int))

    # -- items

    def compute_items(self) -> list[Item]:
        """Items that add the values of this step to the sums."""
        items: list[Item] = []
        body = [code("{steps}[env] = {steps}[env] + 1", steps=self._steps_name)]
        for index, (name, term) in enumerate(self._terms.items()):
            if not is_warp_term(term.func):
                items.append(HostFunction("metrics", self._torch(index, name), f"torch term '{name}'", [name]))
                continue
            call = bind_term(self.context, term.func, term.params, f"metrics.{name}", "metric")
            if call is not None:
                body.append(code("{}[env, {}] += {}  # {}", self._sums_name, index, call.expression(), name))
        return [*items, Section("metrics", body, self.active_terms)] if self._terms else []

    def reset_items(self) -> list[Item]:
        """Items that log the means and clear the sums, where an episode ended."""
        steps = self._steps_name
        lines = [code("steps = float(wp.max({}[env], 1))", steps), code("{}[env] = 0", steps)]
        for index, name in enumerate(self._terms):
            sum_ = code("{}[env, {}]", self._sums_name, index)
            lines += [self.context.log.line(f"Metrics/{name}", code("{} / steps", sum_)), code("{} = 0.0", sum_)]
        return [Section("metrics_log", lines).only(self.context.is_reset)] if self._terms else []

    def _torch(self, index: int, name: str) -> Callable[[], None]:
        call, sums = self.call(name), self.context.torch(self._sums)

        def add() -> None:
            sums[:, index] += call.number_per_env(f"{self.name}.{name}")

        return add

    def __str__(self) -> str:
        return self.table("Metrics", ("Index", "Name"), list(enumerate(self._terms)))
