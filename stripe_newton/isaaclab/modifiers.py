# SPDX-License-Identifier: Apache-2.0
"""Modifiers of ``isaaclab.utils.modifiers``: functions and classes on tensors, by Isaac Lab's formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from stripe_newton import managers as native
from stripe_newton.configclass import MISSING, configclass

__all__ = [
    "DigitalFilter",
    "DigitalFilterCfg",
    "Integrator",
    "IntegratorCfg",
    "ModifierBase",
    "ModifierCfg",
    "bias",
    "clip",
    "scale",
]

EnvIds = Sequence[int] | torch.Tensor | None


def scale(data: torch.Tensor, multiplier: float) -> torch.Tensor:
    """``data * multiplier``."""
    return data * multiplier


def clip(data: torch.Tensor, bounds: tuple[float | None, float | None]) -> torch.Tensor:
    """``data`` within bounds, of which either may be None."""
    return data.clip(min=bounds[0], max=bounds[1])


def bias(data: torch.Tensor, value: float) -> torch.Tensor:
    """``data + value``."""
    return data + value


@configclass
class ModifierCfg(native.ModifierCfg):
    """A function of all numbers of a term, ``func(data, **params)``, or a class derived from :class:`ModifierBase`."""

    func: Callable[..., object] | None = MISSING


class ModifierBase(native.ModifierBase):
    """Base of modifiers with a state."""

    def __init__(self, cfg: ModifierCfg, data_dim: tuple[int, ...], device: str):
        """Keep the arguments."""
        super().__init__(cfg, data_dim, device)
        self._cfg, self._data_dim, self._device = cfg, data_dim, device


class DigitalFilter(ModifierBase):
    """Digital filter ``y_n = sum_k B_k x_{n-k} - sum_k A_{k+1} y_{n-1-k}``; all past values begin as zero."""

    def __init__(self, cfg: DigitalFilterCfg, data_dim: tuple[int, ...], device: str):
        """Make the past values.

        Raises:
            ValueError: a coefficient is missing.
        """
        if cfg.A is None or cfg.B is None:
            raise ValueError("A and B: a digital filter needs both, got None")
        super().__init__(cfg, data_dim, device)
        self.A, self.B = (torch.tensor(c, dtype=torch.float32, device=device) for c in (cfg.A, cfg.B))
        self.x_n = torch.zeros((*data_dim, len(self.B)), device=device)
        """Inputs, the newest first."""
        self.y_n = torch.zeros((*data_dim, len(self.A)), device=device)
        """Outputs, the newest first."""

    def reset(self, env_ids: EnvIds = None) -> None:
        """Set the past values of environments to zero; None means all of them."""
        ids = slice(None) if env_ids is None else env_ids
        self.x_n[ids] = 0.0
        self.y_n[ids] = 0.0

    def __call__(self, data: torch.Tensor) -> torch.Tensor:  # type: ignore[override]  # it has no parameters
        """The filtered data, shape ``data_dim``."""
        self.x_n = torch.cat((data.unsqueeze(-1), self.x_n[..., :-1]), dim=-1)
        y = self.x_n @ self.B - self.y_n @ self.A
        self.y_n = torch.cat((y.unsqueeze(-1), self.y_n[..., :-1]), dim=-1)
        return y


class Integrator(ModifierBase):
    """Integrator by the trapezoidal rule: ``y_n = y_{n-1} + (x_n + x_{n-1}) / 2 dt``, all zero at first."""

    def __init__(self, cfg: IntegratorCfg, data_dim: tuple[int, ...], device: str):
        """Make the integral and the last value."""
        super().__init__(cfg, data_dim, device)
        self._dt = cfg.dt
        self.integral = torch.zeros(data_dim, device=device)
        self.y_prev = torch.zeros(data_dim, device=device)

    def reset(self, env_ids: EnvIds = None) -> None:
        """Set the integrals of environments to zero; None means all of them."""
        ids = slice(None) if env_ids is None else env_ids
        self.integral[ids] = 0.0
        self.y_prev[ids] = 0.0

    def __call__(self, data: torch.Tensor) -> torch.Tensor:  # type: ignore[override]  # it has no parameters
        """The integral, shape ``data_dim``."""
        self.integral += (data + self.y_prev) / 2 * self._dt
        self.y_prev[:] = data
        return self.integral.clone()


@configclass
class DigitalFilterCfg(ModifierCfg):
    """Config of a digital filter."""

    func: Callable[..., object] | None = DigitalFilter
    A: list[float] = MISSING
    """Coefficients of past outputs."""
    B: list[float] = MISSING
    """Coefficients of the present and past inputs."""


@configclass
class IntegratorCfg(ModifierCfg):
    """Config of an integrator."""

    func: Callable[..., object] | None = Integrator
    dt: float = MISSING
    """Time step [s]."""
