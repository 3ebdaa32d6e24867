# SPDX-License-Identifier: Apache-2.0
"""Clock whose milliseconds are calls of a function."""

from __future__ import annotations

from stripe_newton.envs.step_times import Clock


class CountingClock(Clock):
    """Its milliseconds are calls of a function, so that what is between two marks is known exactly."""

    count = 0

    def mark(self):
        return CountingClock.count

    def ms(self, start, end):
        return float(end - start)
