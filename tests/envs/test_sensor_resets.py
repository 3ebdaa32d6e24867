# SPDX-License-Identifier: Apache-2.0
"""Resets of sensors run beside the rest of the step, unless that reads what the sensor has measured."""

from __future__ import annotations

import pytest
import warp as wp

from stripe_kernels.sensors.contact import ContactSensorData
from stripe_newton.cli.run_configs import load_configs
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.fusion import KernelLaunches
from stripe_newton.managers import ObservationTermCfg


@wp.func
def time_in_contact(env: int, sensor: ContactSensorData, out: wp.array[float]):
    for body in range(sensor.current_contact_time.shape[1]):
        out[body] = sensor.current_contact_time[env, body]


@pytest.mark.parametrize("reads", [False, True])
def test_a_reset_is_concurrent_where_nothing_reads_the_sensor_afterwards(reads):
    cfg = load_configs("Stripe-Velocity-Flat-Quadruped-v0", None, agent=False).env
    cfg.scene.num_envs, cfg.sim.device = 2, "cpu"
    if reads:
        params = {"sensor": "contact_forces"}
        cfg.observations.critic.times = ObservationTermCfg(func=time_in_contact, size=17, params=params)
    env = ManagerBasedRLEnv(cfg)
    (reset,) = (stage for stage in env.plan.stages if stage.name == "reset")
    (launches,) = (item for item in reset.items if isinstance(item, KernelLaunches))
    assert launches.name == "contact_forces"
    assert launches.concurrent == (not reads)
    env.close()
