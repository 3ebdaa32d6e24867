# SPDX-License-Identifier: Apache-2.0
"""Manager-based environment without rewards: steps, resets and events, beside the environment with rewards."""

import numpy as np
import torch

from stripe_newton.envs import ManagerBasedEnv, ManagerBasedEnvCfg
from stripe_newton.managers import EventTermCfg
from tests.helpers.cartpole_manager_env import N, actions_of, config, kick, make


def test_it_steps_as_the_environment_with_rewards_does():
    rl = config()
    names = ("decimation", "sim", "scene", "observations", "actions", "events", "seed")
    base = ManagerBasedEnvCfg(**{name: getattr(rl, name) for name in names})
    base.observations = {"state": base.observations.policy}
    envs = ManagerBasedEnv(base), make()
    assert envs[0].max_episode_length > 10**9
    first = [env.reset(seed=5)[0] for env in envs]
    np.testing.assert_array_equal(first[0]["state"], first[1]["policy"])
    for step in range(8):
        obs, extras = envs[0].step(actions_of(step))
        np.testing.assert_array_equal(obs["state"], envs[1].step(actions_of(step))[0]["policy"])
        assert set(extras) == {"log"}
    assert envs[0].episode_length_buf.tolist() == [8] * N
    mask = torch.arange(N) == 2
    envs[0].reset(options={"reset_mask": mask})
    assert envs[0].episode_length_buf.tolist() == [8, 8, 0, 8]
    for env in envs:
        env.close()


def test_events_run_at_intervals():
    cfg = ManagerBasedEnvCfg(
        **{name: getattr(config(), name) for name in ("decimation", "sim", "scene", "observations", "actions")}
    )
    cfg.events = {"kick": EventTermCfg(kick, {"speed": 0.5}, mode="interval", interval_range_s=(0.05, 0.05))}
    env = ManagerBasedEnv(cfg)
    env.reset(seed=0)
    moved = []
    for _ in range(6):
        env.step(torch.zeros(N, 1))
        moved.append(bool((env.scene["robot"].data.joint_vel[:, 0].abs() > 1e-3).all()))
    assert moved == [False, False, True, True, True, True]
    env.close()
