# SPDX-License-Identifier: Apache-2.0
"""Environment base of the Isaac Lab dialect: scene and simulation of its environments, what hooks expect of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import CodeType, FunctionType
from typing import ClassVar

import numpy as np

from stripe_newton import envs as native
from stripe_newton.scene import InteractiveScene as NativeScene
from stripe_newton.sim import Simulation
from stripe_newton.sim import SimulationCfg as NativeSimulationCfg

from .scene import InteractiveScene
from .simulation_context import SimulationContext

__all__ = ["DialectEnv"]

_OBSERVABLES = {
    "get_link_incoming_joint_force": "body_parent_f",
    "body_incoming_joint_wrench_b": "body_parent_f",
    "body_acc_w": "body_qdd",
    "body_lin_acc_w": "body_qdd",
    "body_ang_acc_w": "body_qdd",
}
"""What the solver must be asked to report, by the name that a hook reads."""


def _make_simulation(cfg: NativeSimulationCfg) -> Simulation:
    return SimulationContext(cfg, standalone=False)


class DialectEnv(native.RLEnv):
    """Base of the dialect's environments, before the class of the package in the order of bases."""

    scene_class: ClassVar[type[NativeScene]] = InteractiveScene
    simulation_class: ClassVar[Callable[[NativeSimulationCfg], Simulation]] = staticmethod(_make_simulation)
    _shows_debug: bool = False
    """Whether ``_debug_vis_callback`` runs before a picture."""

    def _prepare_simulation(self) -> None:
        super()._prepare_simulation()
        self.sim.camera = self.cfg.viewer  # type: ignore[attr-defined]  # of SimulationContext
        names = set(_names_in(type(self)))
        wanted = {observable for name, observable in _OBSERVABLES.items() if name in names}
        if wanted:
            cfg = self.sim.cfg
            self.sim.cfg = cfg.replace(observables=tuple({*cfg.observables, *wanted}))

    def set_debug_vis(self, debug_vis: bool) -> bool:
        """Show or hide what ``_set_debug_vis_impl`` and ``_debug_vis_callback`` draw; whether there is anything."""
        try:
            self._set_debug_vis_impl(debug_vis)
        except NotImplementedError:
            return False
        self._shows_debug = debug_vis
        return True

    def _set_debug_vis_impl(self, debug_vis: bool) -> None:
        """Make the markers at the first call, and show or hide them."""
        raise NotImplementedError

    def _debug_vis_callback(self, event: object) -> None:
        """Move the markers, before a picture."""

    def render(self, recompute: bool = False) -> np.ndarray | None:
        """A picture, with the markers where they belong now.

        Args:
            recompute: Has no effect: the picture is always of the current state.
        """
        if self._shows_debug:
            self._debug_vis_callback(None)
        return super().render()

    def close(self, **kwargs: object) -> None:
        super().close(**kwargs)
        if SimulationContext.instance() is self.sim:
            SimulationContext.clear_instance()


def _names_in(cls: type) -> Iterator[str]:
    """Names that the methods of a user's class and of its bases use, those of the package left out."""
    for base in cls.__mro__:
        if base.__module__.partition(".")[0] == "stripe_newton":
            continue
        for value in vars(base).values():
            if isinstance(value, FunctionType):
                yield from _names_of(value.__code__)


def _names_of(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_of(constant)
