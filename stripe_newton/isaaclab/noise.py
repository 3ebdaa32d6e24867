# SPDX-License-Identifier: Apache-2.0
"""Noise of the Isaac Lab dialect: functions without a generator, and models by Isaac Lab's arguments and formulas."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_newton import noise as native
from stripe_newton.configclass import MISSING, configclass

__all__ = ["NoiseModel", "NoiseModelCfg", "NoiseModelWithAdditiveBias", "NoiseModelWithAdditiveBiasCfg"]

EnvIds = Sequence[int] | torch.Tensor | slice | None


class NoiseModel(native.NoiseModel):
    """Noise model without state; a user's model derives from it."""

    def __init__(self, noise_model_cfg: NoiseModelCfg, num_envs: int, device: str):
        """Keep the arguments."""
        super().__init__(noise_model_cfg, num_envs, device)
        self._noise_model_cfg, self._num_envs, self._device = noise_model_cfg, num_envs, device


class NoiseModelWithAdditiveBias(NoiseModel):
    """Noise plus a bias that a reset draws by applying its noise to the bias that there was.

    The operation ``"abs"`` draws a new bias. With ``"add"``, as in Isaac Lab, biases add up from reset to reset.
    """

    def __init__(self, noise_model_cfg: NoiseModelWithAdditiveBiasCfg, num_envs: int, device: str):
        """Make a bias of zero; the first call draws one for each component."""
        super().__init__(noise_model_cfg, num_envs, device)
        self._bias_noise_cfg = noise_model_cfg.bias_noise_cfg
        self._bias = torch.zeros((num_envs, 1), device=device)
        self._is_drawn = not noise_model_cfg.sample_bias_per_component

    def reset(self, env_ids: EnvIds = None) -> None:
        """Draw biases for the environments ``env_ids``; None means all of them."""
        ids = slice(None) if env_ids is None else env_ids
        self._bias[ids] = self._bias_noise_cfg.func(self._bias[ids], self._bias_noise_cfg)

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        """Noisy data plus the biases; ``data``, shape ``(num_envs, ...)``, is not changed."""
        if not self._is_drawn:
            self._bias = self._bias.repeat(1, data.shape[-1])
            self._is_drawn = True
            self.reset()
        return super().__call__(data) + self._bias


@configclass
class NoiseModelCfg(native.NoiseModelCfg):
    """Config of a noise model."""

    class_type: type = NoiseModel
    noise_cfg: native.NoiseCfg = MISSING
    func: object = None
    """Without effect: a manager makes the model."""


@configclass
class NoiseModelWithAdditiveBiasCfg(NoiseModelCfg):
    """Config of a noise model with a bias."""

    class_type: type = NoiseModelWithAdditiveBias
    bias_noise_cfg: native.NoiseCfg = MISSING
    sample_bias_per_component: bool = True
