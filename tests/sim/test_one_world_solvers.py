# SPDX-License-Identifier: Apache-2.0
"""One-world solvers: settings with which MuJoCo steps one environment are refused with several."""

from __future__ import annotations

import newton
import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.sim import MuJoCoSolverCfg


def model_of(worlds: int) -> newton.Model:
    pendulum = newton.ModelBuilder()
    link = pendulum.add_link(mass=1.0, inertia=((0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)))
    joint = pendulum.add_joint_revolute(-1, link)
    pendulum.add_articulation([joint])
    builder = newton.ModelBuilder()
    builder.replicate(pendulum, worlds)
    return builder.finalize(device="cpu")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"use_mujoco_cpu": True},
            "sim.solver.use_mujoco_cpu: is True, which steps one environment, but num_envs is 2",
        ),
        ({"separate_worlds": False}, "sim.solver.separate_worlds: is False, which steps one environment"),
    ],
)
def test_settings_for_one_environment_are_refused_with_two(fields, message):
    cfg = MuJoCoSolverCfg(fused=False, **fields)
    with pytest.raises(ConfigError, match=message):
        cfg.create(model_of(2))
    cfg.create(model_of(1))
