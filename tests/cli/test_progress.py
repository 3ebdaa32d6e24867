# SPDX-License-Identifier: Apache-2.0
"""Progress of long loops: a line every ten seconds, none for short ones."""

import time

from stripe_newton.cli.progress import steps_left


def test_a_long_loop_says_how_far_it_is(monkeypatch, capsys):
    now = 100.0
    monkeypatch.setattr(time, "perf_counter", lambda: now)
    after_step = steps_left("filmed", 10)
    for step in range(1, 11):
        now += 4.0
        after_step(step)
    assert capsys.readouterr().out.splitlines() == [
        "filmed 3 of 10 steps, 28 s left",
        "filmed 6 of 10 steps, 16 s left",
        "filmed 9 of 10 steps, 4 s left",
    ]
    after_step = steps_left("filmed", 10)
    for step in range(1, 11):
        now += 0.5
        after_step(step)
    assert capsys.readouterr().out == ""
