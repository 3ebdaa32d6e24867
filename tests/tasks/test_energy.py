# SPDX-License-Identifier: Apache-2.0
"""Energy manager: its numbers are those of NumPy, in the step's graph, the saved state, rewards, ends and the log."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import MetricTermCfg, RewardTermCfg, TerminationTermCfg
from stripe_tasks.energy import EnergyManagerCfg, battery_empty, cost_of_transport, power
from stripe_tasks.locomotion.manager_based import AntManagerEnvCfg

N, REGENERATION, HEAT = 3, 0.25, 0.02


def config(**fields: float) -> AntManagerEnvCfg:
    cfg = AntManagerEnvCfg(seed=2)
    cfg.sim.device, cfg.scene.num_envs, cfg.scale_rewards_by_dt = "cpu", N, False
    cfg.managers = {"energy": EnergyManagerCfg(regeneration=REGENERATION, heat=HEAT, **fields)}
    cfg.rewards = {"power": RewardTermCfg(power, weight=1.0), "transport": RewardTermCfg(cost_of_transport, weight=1.0)}
    cfg.metrics = {"power": MetricTermCfg(power)}
    return cfg


@pytest.fixture(scope="module")
def env():
    made = ManagerBasedRLEnv(config())
    yield made
    made.close()


def actions(step: int) -> torch.Tensor:
    return torch.sin(0.7 * step + torch.arange(8.0)).repeat(N, 1) * torch.tensor([[0.2], [0.5], [1.0]])


def test_energy_and_transport_are_those_of_numpy(env):
    env.reset(seed=1)
    energy, used = env.custom_managers["energy"], np.zeros(N)
    data = env.scene["robot"].data
    weight = float(data.default_mass[0].double().sum()) * 9.81
    for step in range(15):
        env.step(actions(step))
        effort = (data.struct.joint_drive_effort.numpy() + data.struct.joint_other_effort.numpy()).astype(float)
        speed, velocity = data.joint_vel.double().numpy(), data.root_lin_vel_w[:, :2].double().numpy()
        flow = effort * speed
        each = np.maximum(flow, 0.0) - REGENERATION * np.maximum(-flow, 0.0) + HEAT * effort**2
        used += each.sum(1) * env.step_dt
        np.testing.assert_allclose(energy.power.numpy(), each.sum(1), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(energy.used.numpy(), used, rtol=1e-4)
        transport = each.sum(1) / (weight * np.maximum(np.linalg.norm(velocity, axis=1), 0.1))
        np.testing.assert_allclose(env.reward_manager.step_reward[:, 1].numpy(), transport, rtol=1e-3, atol=1e-6)


def test_it_is_fused_with_the_terminations_and_has_no_kernel_of_its_own(env):
    (kernel,) = (k for k in env.plan.kernels if "energy_measure_energy" in k.source)
    assert "def terminations(" in kernel.source
    assert not env.plan.host_functions
    assert "energy_measure_energy: measure_energy" in env.describe()
    assert "Manager 'energy': EnergyManager" in env.describe()


def test_it_is_saved_and_goes_on(env):
    env.reset(seed=3)
    for step in range(4):
        env.step(actions(step))
    state, used = env.get_state(), env.custom_managers["energy"].used.clone()
    assert (used > 0.0).all()
    after = [env.step(actions(9)) and env.custom_managers["energy"].used.clone() for _ in range(2)]
    env.set_state(state)
    assert torch.equal(env.custom_managers["energy"].used, used)
    assert torch.equal(env.step(actions(9)) and env.custom_managers["energy"].used, after[0])


def test_it_logs_and_begins_anew_with_an_episode(env):
    env.reset()
    for step in range(5):
        env.step(actions(step))
    used = env.custom_managers["energy"].used.clone()
    env.episode_length_buf[1] = env.max_episode_length - 1
    log = env.step(actions(5))[4]["log"]
    after = env.custom_managers["energy"].used
    assert float(log["Energy/used"]) >= float(used[1])
    assert float(log["Energy/cost_of_transport"]) > 0.0
    assert after[1] == 0.0
    assert (after[[0, 2]] > used[[0, 2]]).all()


def test_an_empty_battery_ends_the_episode():
    cfg = config(budget=0.05)
    cfg.terminations = {"empty": TerminationTermCfg(func=battery_empty)}
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=1)
    ends = torch.stack([env.step(actions(step))[2] for step in range(30)])
    assert ends[:, 2].any()
    env.close()


def test_its_numbers_are_parameters_and_its_config_is_checked(env):
    env.context.parameters["managers.energy.heat"] = 0.0
    env.context.parameters["managers.energy.heat"] = HEAT
    with pytest.raises(ConfigError) as caught:
        EnergyManagerCfg(budget=0.0, regeneration=2.0, heat=-1.0).validate()
    assert len(caught.value.problems) == 3
    cfg = config()
    cfg.managers = {"energy": RewardTermCfg(power, weight=1.0)}
    with pytest.raises(ConfigError, match=r"managers\.energy: is RewardTermCfg, must be a CustomManagerCfg or None"):
        ManagerBasedRLEnv(cfg)
