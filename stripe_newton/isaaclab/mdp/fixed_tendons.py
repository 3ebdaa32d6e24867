# SPDX-License-Identifier: Apache-2.0
"""Event of ``isaaclab.envs.mdp`` that changes fixed tendons, in torch."""

from __future__ import annotations

import warnings
from typing import Any

import torch

from stripe_newton import math
from stripe_newton.assets import Articulation, FixedTendons
from stripe_newton.managers import EventTermCfg, ManagerTermBase
from stripe_newton.managers.term_class import TermEnv

from ..scene_entity import SceneEntityCfg

__all__ = ["randomize_fixed_tendon_parameters"]

_SAMPLERS = {
    "uniform": math.sample_uniform,
    "log_uniform": math.sample_log_uniform,
    "gaussian": math.sample_gaussian,
}
_OPERATIONS = {
    "abs": lambda default, draw: draw,
    "add": lambda default, draw: default + draw,
    "scale": lambda default, draw: default * draw,
}
_NO_EFFECT = {
    "limit_stiffness_distribution_params": "limits are constraints of the solver",
    "rest_length_distribution_params": "the solver takes the rest length when it is made",
    "offset_distribution_params": "tendons have no offset",
}

Range = tuple[float, float]


class randomize_fixed_tendon_parameters(ManagerTermBase):
    """Randomise stiffness, damping and limits of fixed tendons, starting from their values as built."""

    def __init__(self, cfg: EventTermCfg, env: TermEnv):
        super().__init__(cfg, env)
        params: dict[str, Any] = cfg.params
        asset_cfg: SceneEntityCfg = params["asset_cfg"]
        asset = env.scene[asset_cfg.name]
        if not isinstance(asset, Articulation):
            raise ValueError(f"'{asset_cfg.name}' is no articulation, it has no fixed tendons")
        self._tendons: FixedTendons = asset.fixed_tendons
        self._ids = list(range(len(self._tendons)))
        if asset_cfg.fixed_tendon_names is not None:
            self._ids = self._tendons.find(asset_cfg.fixed_tendon_names)[0]
        elif not isinstance(asset_cfg.fixed_tendon_ids, slice):
            self._ids = list(asset_cfg.fixed_tendon_ids)
        for name, reason in _NO_EFFECT.items():
            if params.get(name) is not None:
                warnings.warn(f"randomize_fixed_tendon_parameters: {name} has no effect: {reason}", stacklevel=2)

    def __call__(
        self,
        env: object,
        env_ids: torch.Tensor | None,
        asset_cfg: SceneEntityCfg,
        stiffness_distribution_params: Range | None = None,
        damping_distribution_params: Range | None = None,
        limit_stiffness_distribution_params: Range | None = None,
        lower_limit_distribution_params: Range | None = None,
        upper_limit_distribution_params: Range | None = None,
        rest_length_distribution_params: Range | None = None,
        offset_distribution_params: Range | None = None,
        operation: str = "abs",
        distribution: str = "uniform",
    ) -> None:
        """Draw for the environments ``env_ids``; None means all."""
        tendons = self._tendons
        rows = torch.arange(self.num_envs, device=self.device) if env_ids is None else env_ids

        def drawn(default: torch.Tensor, bounds: Range | None) -> torch.Tensor | None:
            if bounds is None or not self._ids:
                return None
            values = default[rows][:, self._ids]
            samples = _SAMPLERS[distribution](*bounds, tuple(values.shape), self.device)
            return _OPERATIONS[operation](values, samples)

        limits = tendons.default_limits[rows][:, self._ids].clone()
        sides = (lower_limit_distribution_params, upper_limit_distribution_params)
        for side, bounds in enumerate(sides):
            if (new := drawn(tendons.default_limits[..., side], bounds)) is not None:
                limits[..., side] = new
        if bool((limits[..., 0] > limits[..., 1]).any()):
            raise ValueError("randomize_fixed_tendon_parameters: lower limits above upper ones were drawn")
        tendons.write(
            stiffness=drawn(tendons.default_stiffness, stiffness_distribution_params),
            damping=drawn(tendons.default_damping, damping_distribution_params),
            limits=limits if any(side is not None for side in sides) else None,
            env_ids=rows,
            tendon_ids=self._ids,
        )
