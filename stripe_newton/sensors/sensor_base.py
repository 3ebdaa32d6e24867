# SPDX-License-Identifier: Apache-2.0
"""What all sensors have in common: when they measure, and for whom."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.sim.stage import authored_path, current_scene

if TYPE_CHECKING:
    import newton

    from stripe_newton.sim import Simulation

__all__ = ["SensorBase", "SensorBaseCfg"]


@configclass
class SensorBaseCfg:
    """What every sensor's config has."""

    prim_path: str = MISSING
    """Body or bodies it measures, such as ``{ENV_REGEX_NS}/Robot/.*_foot``; the last part may be an expression."""
    update_period: float = 0.0
    """Time between two measurements [s], a whole number of environment steps; 0 for one in each step."""
    history_length: int = 0
    """Past measurements that are kept; 0 for none."""
    debug_vis: bool = False
    """Accepted for compatibility."""
    class_type: Callable[..., Any] | None = None
    """Class that the scene makes of this config."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.update_period) and self.update_period >= 0.0):
            yield "update_period", f"is {self.update_period}, must be a time, 0 or more [s]"
        if not isinstance(self.history_length, int) or self.history_length < 0:
            yield "history_length", f"is {self.history_length!r}, must be a whole number, 0 or more"


class SensorBase:
    """A sensor of the scene under construction.

    The scene calls :meth:`prepare` before the model is made and :meth:`initialize` after it. A step calls the
    ``launch_*`` methods, which launch kernels and do nothing else, so that they become part of its graph.

    Attributes:
        cfg: The config.
        struct: What terms read, a Warp struct of arrays that lead with the environment.
    """

    every_substep: bool = False
    """Whether it measures after every physics step; a sensor may set it for itself."""

    cfg: Any
    struct: Any = None
    unavailable: Mapping[str, str] = {}
    """Fields of :attr:`struct` that terms may not read, and why."""

    def __init__(self, cfg: Any):
        cfg.validate()
        self.cfg = cfg.copy()
        self._scene = current_scene()
        parent, _, self.expression = self.cfg.prim_path.rpartition("/")
        self.parent_path = authored_path(parent)
        """Prim above those that it measures, in the first environment."""

    # -- construction

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        """Ask for what the solver must report, add sites to the builder of one environment.

        Args:
            sim: The simulation, before its model is made.
            template: Builder of one environment.
            static: Builder of what all environments share.
        """

    def initialize(self, sim: Simulation) -> None:
        """Make the arrays, once the model is there."""
        self._sim = sim
        self.device, self.num_envs = sim.device, sim.num_envs

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies it measures, in the order of its data."""
        return []

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that last from step to step, by name; they are saved with the environment's state."""
        return {}

    @property
    def counts(self) -> dict[str, int]:
        """What sizes of observations depend on, such as ``num_rays``."""
        return {}

    # -- what a step launches

    def launch_substep(self) -> None:
        """Measure after a physics step; called where :attr:`every_substep` is set."""

    def launch_measured(self) -> None:
        """Measure on the state after the physics of a step, before terminations and rewards."""

    def launch_reset(self, env_mask: wp.array) -> None:
        """Forget the past of environments whose episode just ended.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """

    def launch_observed(self) -> None:
        """Measure after forward kinematics of the environments that began anew, before the observations."""

    @property
    def measures(self) -> list[str]:
        """Names of the ``launch_*`` methods that it has."""
        return [n for n in _LAUNCHES if getattr(type(self), n) is not getattr(SensorBase, n)]

    # -- outside a graph

    def update(self, dt: float) -> None:
        """Measure, after ``dt`` seconds of physics; for scripts and environments with torch hooks."""
        with wp.ScopedDevice(self.device):
            self.launch_measured()
            self.launch_observed()

    def reset(self, env_ids: Sequence[int] | torch.Tensor | slice | None = None) -> None:
        """Forget the past of some environments, default all."""
        mask = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        mask[slice(None) if env_ids is None else env_ids] = True
        with wp.ScopedDevice(self.device):
            self.launch_reset(wp.from_torch(mask, dtype=wp.bool))


_LAUNCHES = "launch_substep", "launch_measured", "launch_reset", "launch_observed"
