# SPDX-License-Identifier: Apache-2.0
"""Episode log: means, counts and last values that kernels write, and the keys of the log."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_newton.fusion import EpisodeLog, KernelLaunches, Scope, Section, block, code
from tests.helpers.manager_world import plan, set_reset


def test_log(cart):
    log = cart.log
    lines = [
        log.line("ended", "float(env) + 1.0", "mean"),
        log.line("how_many", "1.0", "count"),
    ]
    section = Section("log_lines", lines).only(cart.is_reset)
    last = Section("level", block(code("if env == 0:"), [log.line("level", cart.code("float({step}[0])"), "last")]))
    work = plan(cart, [section, last, KernelLaunches("log", log.finish)])
    values = wp.to_torch(log.values)
    got = []
    for step, mask in enumerate([[1, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 1]]):
        set_reset(cart, [bool(m) for m in mask])
        wp.to_torch(cart.step)[:] = step
        work.run()
        got.append(dict(zip(log.keys, values.tolist(), strict=False)))
    assert log.keys == ["ended", "how_many", "level"]
    assert got[0] == {"ended": 2.0, "how_many": 2.0, "level": 0.0}
    assert got[1] == {"ended": 2.0, "how_many": 0.0, "level": 1.0}
    assert got[2] == {"ended": 4.0, "how_many": 1.0, "level": 2.0}


def test_log_keys():
    log = EpisodeLog(Scope(), "cpu")
    assert [log.add("a"), log.add("b", "count"), log.add("a")] == [0, 1, 0]
    with pytest.raises(ValueError, match="log 'c': kind is 'sum', must be one of mean, count, last"):
        log.add("c", "sum")
