# SPDX-License-Identifier: Apache-2.0
"""Substeps: the physics steps of an environment step, with the action hook before each of them or once before all."""

from __future__ import annotations

import warnings
from typing import Protocol

import torch
import warp as wp

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation

__all__ = ["Substeps"]


class HasActionHook(Protocol):
    """An environment with a scene, a simulation and an action hook."""

    scene: InteractiveScene
    sim: Simulation

    def run_apply_action(self) -> None: ...


class Substeps:
    """Runs the physics of a step, with ``_apply_action`` before each physics step or once before all.

    In the mode ``"auto"`` it watches some steps, in which the hook runs before every physics step and its targets are
    compared. While they are equal within each step, the hook runs once in the other steps, whose physics is one CUDA
    graph. It goes on watching now and then, as a control law that depends on the state may be saturated at first. Once
    targets differ, the hook runs before every physics step from then on.
    """

    FIRST, NEXT, LONGEST = 3, 64, 4096
    """The first ``FIRST`` steps are watched, then the step ``NEXT``; the distance doubles, up to ``LONGEST``."""

    def __init__(self, mode: str, decimation: int):
        self.mode = mode if decimation > 1 else "step"
        """``"step"``, ``"substep"``, or ``"auto"`` until targets have differed within a step."""
        self._decimation = decimation
        self._count = 0

    @property
    def each(self) -> bool:
        """Whether the hook runs before every physics step of every step."""
        return self.mode == "substep"

    @property
    def is_decided(self) -> bool:
        """Whether the first steps have been watched, if any are."""
        return self.mode != "auto" or self._count >= self.FIRST

    @property
    def watches(self) -> bool:
        """Whether the next step is watched."""
        if self.mode != "auto" or self._count < self.FIRST:
            return self.mode == "auto"
        periods, rest = divmod(self._count, self.NEXT)
        # At 64, 128, 256 and so on: a power of two has one bit.
        return rest == 0 and (periods.bit_count() == 1 or self._count % self.LONGEST == 0)

    def count_step(self) -> None:
        """Count a step whose physics ran elsewhere."""
        self._count += 1

    def run(self, env: HasActionHook) -> None:
        """Run the physics of one environment step."""
        watch = self.watches
        self._count += 1
        if watch:
            self._watch(env)
            return
        per_call = 1 if self.each else self._decimation
        for _ in range(0, self._decimation, per_call):
            env.run_apply_action()
            env.sim.step(per_call)

    def _watch(self, env: HasActionHook) -> None:
        before: list[torch.Tensor] | None = None
        for _ in range(self._decimation):
            state = _state(env.sim)
            env.run_apply_action()
            targets = _targets(env.sim)
            if not _same(state, _state(env.sim)) or (before is not None and not _same(before, targets)):
                self._found(env)
            before = targets
            env.sim.step(1)

    def _found(self, env: HasActionHook) -> None:
        if self.mode == "auto" and self._count > self.FIRST:
            warnings.warn(
                f"{type(env).__name__}._apply_action depends on the state, which the first steps did not show: it runs "
                "before every physics step from now on; set apply_action='substep' for it to do so from the start",
                stacklevel=2,
            )
        self.mode = "substep"


def _state(sim: Simulation) -> list[torch.Tensor]:
    return [wp.to_torch(a).clone() for a in (sim.state.joint_q, sim.state.joint_qd) if a is not None]


def _targets(sim: Simulation) -> list[torch.Tensor]:
    control = sim.control
    arrays = (control.joint_target_q, control.joint_target_qd, control.joint_act, sim.external_wrench)
    return [wp.to_torch(a).clone() for a in arrays if a is not None]


def _same(before: list[torch.Tensor], now: list[torch.Tensor]) -> bool:
    if [a.shape for a in before] != [a.shape for a in now]:
        return False
    # One wait of the host for all arrays, rather than one for each.
    return not before or bool(torch.stack([(a == b).all() for a, b in zip(before, now, strict=True)]).all())
