# SPDX-License-Identifier: Apache-2.0
"""Many degrees of freedom: MuJoCo's solver says what is too much for it before it begins."""

import warnings
from types import SimpleNamespace
from typing import Any

import pytest

from stripe_newton.sim.many_dofs import check_dof_count


def model(bodies: int, worlds: int = 1, memory: float = 0.0) -> Any:
    device = SimpleNamespace(is_cuda=memory > 0.0, total_memory=memory)
    return SimpleNamespace(world_count=worlds, joint_dof_count=6 * bodies * worlds, device=device)


def test_a_crowd_of_robots_is_no_large_scene() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_dof_count(model(bodies=10, worlds=4096))


def test_many_bodies_are_said_to_be_slow() -> None:
    with pytest.warns(UserWarning, match=r"6,000 degrees of freedom, for which .* 0.9 GB, and steps take long; .*XPBD"):
        check_dof_count(model(bodies=1000, memory=80e9))


def test_more_bodies_than_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"86.4 GB, and the device has 80.0 GB; SimulationCfg\(solver=XPBDSolverCfg"):
        check_dof_count(model(bodies=10_000, memory=80e9))
