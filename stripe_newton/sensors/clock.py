# SPDX-License-Identifier: Apache-2.0
"""Sensor clock: when a sensor measures, for each environment, on the device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from stripe_kernels.sensors import clock as kernels
from stripe_newton.configclass import ConfigError

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["SensorClock", "period_steps"]


def period_steps(sim: Simulation, update_period: float, where: str) -> int:
    """Environment steps in a period; 1 for a period of 0 or of at most a physics step.

    Raises:
        ConfigError: if it is not a whole number of steps.
    """
    step_dt = sim.physics_dt * sim.decimation
    steps = round(update_period / step_dt)
    # Configs of Isaac Lab say "always" by a period of a physics step: it need not be a whole number of steps.
    off = abs(steps * step_dt - update_period) > 1.0e-6 * update_period
    if update_period > 1.000001 * sim.physics_dt and off:
        right = f"must be a multiple of the step of {step_dt:g} s, such as {max(steps, 1) * step_dt:g}"
        raise ConfigError([f"{where}.update_period: is {update_period} s, {right}"])
    return max(steps, 1)


class SensorClock:
    """Says where a measurement is due, without host synchronisation.

    A sensor that measures within the step hands :attr:`due` to its kernels there, ends ``launch_measured`` with
    :meth:`advance`, and in ``launch_observed`` measures where :attr:`restarted`, then calls :meth:`settle`. One that
    measures before the observations (``observed=True``) calls :meth:`count` in ``launch_measured``, hands :attr:`due`
    to its kernels in ``launch_observed``, then calls :meth:`settle`. Both call :meth:`restart` in ``launch_reset``, so
    that the first observation of an episode is fresh.

    Attributes:
        period: Environment steps from one measurement to the next.
        due: Where the next measurement is taken, bool, shape ``(num_envs,)``.
        restarted: Where an episode began since the last observations, bool, shape ``(num_envs,)``.
    """

    def __init__(
        self,
        sim: Simulation,
        update_period: float,
        where: str,
        observed: bool = False,
        starts_fresh: bool = True,
        remembers: bool = False,
    ):
        """Allocate.

        Args:
            sim: The simulation, built.
            update_period: Time between two measurements [s]; 0 for one in each step.
            where: Path of the sensor's config, for the error.
            observed: Whether it measures before the observations rather than within the step.
            starts_fresh: Whether one that measures within the step measures at the start of an episode too.
            remembers: Whether a measurement depends on those before it, by noise or delay. One before the observations
                is then taken once a step, even where a reset from outside computes observations between two steps.

        Raises:
            ConfigError: if the period is not a whole number of environment steps.
        """
        self.period = period_steps(sim, update_period, where)
        self.observed, self._marks, self._count = observed, starts_fresh and not observed, sim.num_envs
        # A measurement before the observations belongs to the step that ends there: the first one is due at once. One
        # within the step is taken by the reset itself, or, without a fresh start, a period later.
        self._start = self.period if observed else 1
        # Where every step measures and nothing is remembered, due stays True: no kernel needs to count.
        self._counts = self.period > 1 or (observed and remembers)
        with wp.ScopedDevice(sim.device):
            self._age = wp.full(self._count, value=self._start, dtype=int)
            self.due = wp.full(self._count, value=self._start >= self.period, dtype=wp.bool)
            self.restarted = wp.zeros(self._count, dtype=wp.bool)

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name."""
        there = {"clock.age": self._age, "clock.due": self.due} if self._counts else {}
        return there | ({"clock.restarted": self.restarted} if self._marks else {})

    def advance(self) -> None:
        """End the measurement of a step."""
        if self.period > 1:
            wp.launch(kernels.advance, dim=self._count, inputs=[self.period], outputs=[self._age, self.due])

    def count(self) -> None:
        """Count a step, before the measurement."""
        if self._counts:
            wp.launch(kernels.count_step, dim=self._count, inputs=[self.period], outputs=[self._age, self.due])

    def restart(self, env_mask: wp.array) -> None:
        """Begin episodes.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        if self._marks:
            wp.launch(kernels.mark, dim=self._count, inputs=[env_mask], outputs=[self.restarted])
        if self._counts:
            steps = [env_mask, self._start, self.period]
            wp.launch(kernels.restart, dim=self._count, inputs=steps, outputs=[self._age, self.due])

    def settle(self) -> None:
        """End the measurement before the observations."""
        if self._marks:
            self.restarted.zero_()
        elif self._counts:
            wp.launch(kernels.settle, dim=self._count, inputs=[], outputs=[self._age, self.due])
