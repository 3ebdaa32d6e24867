# SPDX-License-Identifier: Apache-2.0
"""Randomisation on a GPU: a recorded and replayed graph draws and writes the same as the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stripe_newton.fusion import Plan, Stage
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.manager_world import set_reset
from tests.helpers.randomization_world import RandomizedWorld, all_arrays, events

pytestmark = pytest.mark.gpu

DEVICE, N = "cuda:0", 8
MASKS = [[True] * N, [i % 3 == 0 for i in range(N)], [False] * N, [i > 4 for i in range(N)]]
SOLVERS: dict[str, dict[str, Any]] = {"masked": {}, "notified": {"kinematic_switchable_roots": True}}


@pytest.mark.parametrize("options", SOLVERS.values(), ids=list(SOLVERS))
def test_replays_equal_the_cpu(options: dict[str, Any]):
    found = []
    for device in (DEVICE, "cpu"):
        solver = MuJoCoSolverCfg(**options)
        world = RandomizedWorld(QUADRUPED_CFG, events("reset"), num_envs=N, solver=solver, device=device)
        stages = [Stage("reset", world.items("reset"))]
        plan = Plan("test", stages, world.context.scope, N, device, use_graph=True)
        for mask in MASKS:
            set_reset(world.context, mask)
            plan.run()
        assert plan.graph_count == (device == DEVICE)
        found.append(all_arrays(world))
    replayed, wanted = found
    for name, values in wanted.items():
        if name == "body_iquat":  # the axes of equal moments are free
            continue
        finite = np.where(np.abs(values) < 1e6, np.abs(values), 0.0)
        np.testing.assert_allclose(replayed[name], values, rtol=1e-4, atol=1e-5 * finite.max(initial=1.0), err_msg=name)


def test_replays_leave_other_worlds_alone():
    world = RandomizedWorld(QUADRUPED_CFG, events("reset"), num_envs=N, device=DEVICE)
    plan = Plan("test", [Stage("reset", world.items("reset"))], world.context.scope, N, DEVICE, use_graph=True)
    for mask in MASKS[:2]:
        set_reset(world.context, mask)
        plan.run()
    before = all_arrays(world)
    set_reset(world.context, MASKS[3])
    plan.run()
    after = all_arrays(world)
    assert not np.array_equal(before["dof_invweight0"][5:], after["dof_invweight0"][5:])
    for name, values in before.items():
        np.testing.assert_array_equal(after[name][:5], values[:5], err_msg=name)
