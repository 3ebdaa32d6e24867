# SPDX-License-Identifier: Apache-2.0
"""RL environment config: the base of the configs of all environments."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SimulationCfg
from stripe_newton.value_types import PositiveInt, Range, Seed
from stripe_newton.viewers import ViewerCfg

__all__ = ["RLEnvCfg"]


@configclass
class RLEnvCfg:
    """Base of the configs of environments."""

    viewer: ViewerCfg = ViewerCfg()
    """Camera of ``render()`` and of videos."""
    sim: SimulationCfg = SimulationCfg()
    """Time step, gravity, device, solver."""
    seed: Seed | None = None
    """Seed of the random numbers; ``None`` leaves them unseeded."""
    decimation: PositiveInt = MISSING
    """Physics steps in an environment step."""
    is_finite_horizon: bool = False
    """The time limit is part of the task: learners then treat a time-out as the end, not as truncation."""
    episode_length_s: Annotated[float, Range(above=0.0, at_most=1.0e9)] = MISSING
    """Duration of an episode [s]."""
    scene: InteractiveSceneCfg = MISSING
    """The scene."""
    events: object = None
    """Config whose fields are :class:`EventTermCfg`, or a dict of them."""
    nonfinite_actions: str = "raise"
    """Treatment of actions that are not finite: ``"raise"`` an error, or ``"clamp"`` NaN to 0 and infinity to +-1e6. On
    a GPU they are clamped at once and the error is raised a few steps later, without host synchronisation."""
    compute_final_obs: bool = False
    """Compute the last observations of episodes that end, for ``extras["final_obs"]``."""
    rerender_on_reset: bool = False
    """Ignored: ``render()`` always draws the current state."""
    IGNORED: ClassVar[dict[str, str]] = {"rerender_on_reset": "render() always draws the current state"}

    def complete(self) -> None:
        """Fill fields that follow from others.

        An environment calls it on its copy of the config, before it checks the fields. The default does nothing.
        """

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.nonfinite_actions not in ("raise", "clamp"):
            yield "nonfinite_actions", f"is '{self.nonfinite_actions}', must be 'raise' or 'clamp'"
