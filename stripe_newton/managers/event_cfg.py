# SPDX-License-Identifier: Apache-2.0
"""Event term config: a function that changes environments, and the times at which it runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import NonNegativeInt

__all__ = ["EventManagerCfg", "EventTermCfg"]

_MODES = ("prestartup", "startup", "reset", "interval", "step")


@configclass
class EventTermCfg:
    """Config of an event term: a function that changes environments, and the times at which it runs."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...)``, or torch function ``(env, env_ids, **params)`` with an int64 tensor of
    environments."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""
    mode: str = MISSING
    """Time at which it runs: ``"prestartup"``, once before the model is built (torch only, ``env_ids`` is None);
    ``"startup"``, once after that; ``"reset"``, where an episode begins; ``"interval"``, at random intervals;
    ``"step"``, in every step."""
    interval_range_s: tuple[float, float] | None = None
    """Bounds of the time between two runs [s], drawn uniformly and rounded up to whole steps; for mode ``"interval"``.
    """
    is_global_time: bool = False
    """Use one clock for all environments, which resets do not restart, rather than one for each."""
    min_step_count_between_reset: NonNegativeInt = 0
    """Least number of environment steps between two runs in the same environment; for mode ``"reset"``."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.mode is not MISSING and self.mode not in _MODES:
            yield "mode", f"is '{self.mode}', must be one of {', '.join(_MODES)}"
        bounds, count = self.interval_range_s, self.min_step_count_between_reset
        if self.mode == "interval" and not _is_range(bounds):
            yield "interval_range_s", f"is {bounds}, must be finite (low, high) with 0 <= low <= high, not both 0 [s]"
        if not isinstance(count, int) or count < 0:
            yield "min_step_count_between_reset", f"is {count!r}, must be a whole number of steps, 0 or more"


@configclass
class EventManagerCfg:
    """Config of the event manager: a field for each term.

    Subclass it, or name them: ``EventManagerCfg(NAME=EventTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (EventTermCfg,)


def _is_range(bounds: object) -> bool:
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        return False
    finite = all(isinstance(b, (int, float)) and math.isfinite(b) for b in bounds)
    return finite and 0 <= bounds[0] <= bounds[1] and bounds[1] > 0  # an interval below a step is one step
