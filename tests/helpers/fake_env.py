# SPDX-License-Identifier: Apache-2.0
"""Vector environment with the interface of ``DirectRLEnv`` and almost no work in it, for the tests of rl and cli.

A cart on a line is pushed by the action and shall stay at the middle; leaving the line ends the episode.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch

from stripe_newton.configclass import configclass
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg

STEP_DT = 0.1
TASK = "Fake-Cart-v0"


@configclass
class FakeSimCfg:
    dt: float = 0.05
    """Physics step (s)."""
    device: str = "cuda:0"
    """Device."""
    render_interval: int = 1
    """Physics steps between updates of the live viewer."""


@configclass
class FakeSceneCfg:
    num_envs: int = 16
    """Number of environments."""


@configclass
class FakeCartCfg:
    """Cart on a spring, without physics."""

    seed: int | None = None
    """Seed."""

    decimation: int = 1
    """Physics steps in a step."""
    sim: FakeSimCfg = FakeSimCfg()
    scene: FakeSceneCfg = FakeSceneCfg()
    episode_length_s: float = 3.0
    """Episode length (s)."""
    limit: float = 2.0
    """Half the length of the line (m)."""
    push: tuple[float, float] = (-3.0, 3.0)
    """Smallest and largest acceleration (m/s^2)."""
    is_finite_horizon: bool = False
    gains: dict[str, float] = {"push": 1.0}
    reward_scale: Any = None

    def problems(self):
        if self.limit <= 0.0:
            yield "limit", f"is {self.limit}, must be above 0"


class FakeCartEnv(gymnasium.vector.VectorEnv):
    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}

    def __init__(self, cfg: FakeCartCfg, render_mode: str | None = None, **kwargs: Any):
        self.cfg, self.render_mode = cfg, render_mode
        self.num_envs, self.device = cfg.scene.num_envs, cfg.sim.device
        self.step_dt = STEP_DT
        self.max_episode_length = round(cfg.episode_length_s / STEP_DT)
        self.single_observation_space = gymnasium.spaces.Dict(
            {
                "policy": gymnasium.spaces.Box(-np.inf, np.inf, (2,)),
                "critic": gymnasium.spaces.Box(-np.inf, np.inf, (1,)),
            }
        )
        self.single_action_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
        self.generator = torch.Generator(device=self.device).manual_seed(cfg.seed or 0)
        self.x = torch.zeros(self.num_envs, 2, device=self.device)
        self._length = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self.success = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        self.steps_taken = 0

    @property
    def episode_length_buf(self) -> torch.Tensor:
        return self._length

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        self._length.copy_(value)

    def reset(self, seed: int | None = None, options: dict | None = None):
        if seed is not None:
            self.generator.manual_seed(seed)
        self._reset(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
        return self._observe(), {}

    def step(self, action: torch.Tensor):
        low, high = self.cfg.push
        force = (action[:, 0] * self.cfg.gains["push"]).clamp(low, high)
        self.x[:, 1] += force * STEP_DT
        self.x[:, 0] += self.x[:, 1] * STEP_DT
        self._length += 1
        self.steps_taken += 1
        terminated = self.x[:, 0].abs() > self.cfg.limit
        truncated = self._length >= self.max_episode_length
        reward = 1.0 - self.x[:, 0] ** 2 - 0.1 * self.x[:, 1] ** 2 - 5.0 * terminated
        self.success = truncated & (self.x[:, 0].abs() < 0.5)
        log = {"Episode/distance": self.x[:, 0].abs().mean()}
        self._reset(terminated | truncated)
        return self._observe(), reward, terminated, truncated, {"log": log}

    def render(self) -> np.ndarray:
        image = np.full((48, 96, 3), 200, dtype=np.uint8)
        column = int(np.clip(48 + 20 * float(self.x[0, 0]), 2, 93))
        image[20:28, column - 2 : column + 3] = (200, 40, 40)
        return image

    def get_state(self) -> dict[str, Any]:
        return {"x": self.x, "length": self._length, "rng": self.generator.get_state(), "steps": self.steps_taken}

    def set_state(self, state: dict[str, Any]) -> None:
        self.x.copy_(state["x"])
        self._length.copy_(state["length"])
        self.generator.set_state(state["rng"])
        self.steps_taken = state["steps"]

    def close(self) -> None:
        pass

    def _reset(self, mask: torch.Tensor) -> None:
        fresh = torch.rand(self.num_envs, 2, generator=self.generator, device=self.device) * 2.0 - 1.0
        self.x = torch.where(mask[:, None], fresh, self.x)
        self._length[mask] = 0

    def _observe(self) -> dict[str, torch.Tensor]:
        return {"policy": self.x.clone(), "critic": self._length[:, None] / self.max_episode_length}


@configclass
class FakeCartRunnerCfg(RslRlOnPolicyRunnerCfg):
    num_steps_per_env = 16
    max_iterations = 6
    save_interval = 2
    experiment_name = "fake_cart"
    obs_groups = {"actor": ["policy"], "critic": ["policy", "critic"]}
    actor = RslRlMLPModelCfg(
        hidden_dims=(16, 16),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.7),
    )
    critic = RslRlMLPModelCfg(hidden_dims=(16, 16))
    algorithm = RslRlPpoAlgorithmCfg(num_learning_epochs=3, num_mini_batches=2, learning_rate=3e-3)


if TASK not in gymnasium.registry:
    gymnasium.register(
        id=TASK,
        vector_entry_point=f"{__name__}:FakeCartEnv",
        kwargs={
            "env_cfg_entry_point": f"{__name__}:FakeCartCfg",
            "rsl_rl_cfg_entry_point": f"{__name__}:FakeCartRunnerCfg",
        },
    )
