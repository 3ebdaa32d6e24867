# SPDX-License-Identifier: Apache-2.0
"""Noise on observations and actions.

A :class:`NoiseCfg` describes the distribution and how a sample enters the data (``operation``);
``cfg.func(data, cfg)`` applies it. A noise *model* keeps state for every environment that lasts longer than a step,
such as a bias drawn once per episode::

    observation_noise_model = NoiseModelWithAdditiveBiasCfg(
        noise_cfg=GaussianNoiseCfg(mean=0.0, std=0.01),
        bias_noise_cfg=UniformNoiseCfg(n_min=-0.05, n_max=0.05),
    )

Data are tensors ``(num_envs, ...)``; the numbers of a config are floats or tensors that broadcast against them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import torch

from stripe_newton.configclass import MISSING, configclass

__all__ = [
    "ConstantNoiseCfg",
    "GaussianNoiseCfg",
    "NoiseCfg",
    "NoiseModel",
    "NoiseModelCfg",
    "NoiseModelWithAdditiveBias",
    "NoiseModelWithAdditiveBiasCfg",
    "UniformNoiseCfg",
    "constant_noise",
    "gaussian_noise",
    "uniform_noise",
]

Value = torch.Tensor | float
_OPERATIONS = ("add", "scale", "abs")


def constant_noise(data: torch.Tensor, cfg: ConstantNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """``data`` with a constant added, multiplied, or as replacement. ``generator`` is not used."""
    return _combine(data, _like(cfg.bias, data), cfg.operation)


def uniform_noise(data: torch.Tensor, cfg: UniformNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """``data`` with noise uniform in [``n_min``, ``n_max``), independent for each element."""
    low, high = _like(cfg.n_min, data), _like(cfg.n_max, data)
    sample = torch.rand(data.shape, dtype=data.dtype, device=data.device, generator=generator)
    return _combine(data, low + (high - low) * sample, cfg.operation)


def gaussian_noise(data: torch.Tensor, cfg: GaussianNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """``data`` with normal noise of the given mean and standard deviation, independent for each element."""
    sample = torch.randn(data.shape, dtype=data.dtype, device=data.device, generator=generator)
    return _combine(data, _like(cfg.mean, data) + _like(cfg.std, data) * sample, cfg.operation)


@configclass
class NoiseCfg:
    """Base of the noise configs."""

    func: Callable[..., torch.Tensor] = MISSING
    """Called as ``func(data, cfg, generator)``, or without the generator. Returns new data of the same shape."""

    operation: str = "add"
    """``"add"``: data + noise; ``"scale"``: data * noise; ``"abs"``: the noise instead of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield each problem as ``(field, message)``."""
        if self.operation not in _OPERATIONS:
            yield "operation", f"got {self.operation!r}, expected one of {', '.join(map(repr, _OPERATIONS))}"


@configclass
class ConstantNoiseCfg(NoiseCfg):
    """The same value for each environment and step."""

    func: Callable[..., torch.Tensor] = constant_noise
    """The function that applies it."""

    bias: Value = 0.0
    """The value, in the unit of the data."""


@configclass
class UniformNoiseCfg(NoiseCfg):
    """Noise uniform in [``n_min``, ``n_max``)."""

    func: Callable[..., torch.Tensor] = uniform_noise
    """The function that applies it."""

    n_min: Value = -1.0
    """Lower bound, in the unit of the data."""

    n_max: Value = 1.0
    """Upper bound, in the unit of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield each problem as ``(field, message)``."""
        yield from NoiseCfg.problems(self)
        if bool((torch.as_tensor(self.n_min) > torch.as_tensor(self.n_max)).any()):
            yield "n_min", f"is {self.n_min}, above n_max = {self.n_max}"


@configclass
class GaussianNoiseCfg(NoiseCfg):
    """Normal noise."""

    func: Callable[..., torch.Tensor] = gaussian_noise
    """The function that applies it."""

    mean: Value = 0.0
    """Mean, in the unit of the data."""

    std: Value = 1.0
    """Standard deviation, in the unit of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield each problem as ``(field, message)``."""
        yield from NoiseCfg.problems(self)
        if bool((torch.as_tensor(self.std) < 0).any()):
            yield "std", f"is {self.std}, must not be negative"


class NoiseModel:
    """Noise without state: ``noise_cfg`` applied at each call."""

    def __init__(
        self, cfg: NoiseModelCfg, num_envs: int, device: str | torch.device, generator: torch.Generator | None = None
    ):
        """``generator``, on the same device, is the source of random numbers. None: torch's default generator."""
        self.cfg = cfg
        self.num_envs = num_envs
        self.device = device
        self.generator = generator

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Start a new episode in the environments ``env_ids``. None: all."""

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        """Noisy data; ``data`` is ``(num_envs, ...)`` and is not changed."""
        return _apply(data, self.cfg.noise_cfg, self.generator)


class NoiseModelWithAdditiveBias(NoiseModel):
    """Noise at each call, plus a bias that each environment keeps from one reset to the next."""

    cfg: NoiseModelWithAdditiveBiasCfg

    def __init__(
        self,
        cfg: NoiseModelWithAdditiveBiasCfg,
        num_envs: int,
        device: str | torch.device,
        generator: torch.Generator | None = None,
    ):
        """See :class:`NoiseModel`. Biases are drawn at the first call, when the shape of the data is known."""
        super().__init__(cfg, num_envs, device, generator)
        self.bias: torch.Tensor | None = None
        """Biases, ``(num_envs, ...)`` as the data or ``(num_envs, 1, ...)``; None before the first call."""

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Draw new biases for the environments ``env_ids``. None: all."""
        if self.bias is None:  # the first call will draw them
            return
        ids: slice | torch.Tensor = slice(None)
        if env_ids is not None:
            given = env_ids if isinstance(env_ids, torch.Tensor) else torch.tensor(env_ids, dtype=torch.long)
            ids = given.to(self.bias.device)
        self.bias[ids] = self._draw(self.bias[ids])  # in place: a recorded graph may hold its address

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        """Noisy data plus bias; ``data`` is ``(num_envs, ...)`` and is not changed."""
        if self.bias is None:
            shape = data.shape if self.cfg.sample_bias_per_component else (data.shape[0],) + (1,) * (data.ndim - 1)
            self.bias = self._draw(torch.zeros(shape, dtype=data.dtype, device=data.device))
        return super().__call__(data) + self.bias

    def _draw(self, like: torch.Tensor) -> torch.Tensor:
        return _apply(torch.zeros_like(like), self.cfg.bias_noise_cfg, self.generator)


@configclass
class NoiseModelCfg:
    """Config of noise without state."""

    class_type: type = NoiseModel
    """Created by ``class_type(cfg, num_envs, device, generator)``, or without the generator."""

    noise_cfg: NoiseCfg = MISSING
    """The noise of each step."""


@configclass
class NoiseModelWithAdditiveBiasCfg(NoiseModelCfg):
    """Config of noise at each step, plus a bias drawn at each reset."""

    class_type: type = NoiseModelWithAdditiveBias
    """Created by ``class_type(cfg, num_envs, device, generator)``, or without the generator."""

    bias_noise_cfg: NoiseCfg = MISSING
    """Distribution of the bias; it is applied to zeros."""

    sample_bias_per_component: bool = True
    """Whether each component of the data has its own bias, rather than one for all components of an environment."""


def _apply(data: torch.Tensor, cfg: NoiseCfg, generator: torch.Generator | None) -> torch.Tensor:
    # Functions of Isaac Lab's form, func(data, cfg), work as long as nobody asks for a generator.
    return cfg.func(data, cfg) if generator is None else cfg.func(data, cfg, generator)


def _like(value: Value, data: torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(value, dtype=data.dtype, device=data.device)


def _combine(data: torch.Tensor, noise: torch.Tensor, operation: str) -> torch.Tensor:
    if operation == "add":
        return data + noise
    if operation == "scale":
        return data * noise
    if operation == "abs":
        return noise.expand(data.shape).clone()  # new data, as the other operations return
    raise ValueError(f"operation: got {operation!r}, expected one of {', '.join(map(repr, _OPERATIONS))}")
