# SPDX-License-Identifier: Apache-2.0
"""Noise on observations and actions: configs of distributions, and noise models with a state.

A :class:`NoiseCfg` gives the distribution and the operation that applies it to the data; ``cfg.func(data, cfg)``
returns noisy data. A noise *model* keeps state for every environment that lasts longer than a step, such as a bias
drawn once an episode::

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
    "AdditiveGaussianNoiseCfg",
    "AdditiveUniformNoiseCfg",
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

Value = torch.Tensor | float | Sequence[float]
"""Number of a config: a float, or numbers that broadcast against the data."""
_OPERATIONS = ("add", "scale", "abs")


def constant_noise(data: torch.Tensor, cfg: ConstantNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """Apply constant noise to ``data``, by the operation of ``cfg``. ``generator`` is not used.

    Example:
        >>> constant_noise(torch.tensor([1.0, 2.0]), ConstantNoiseCfg(bias=0.5))
        tensor([1.5000, 2.5000])
    """
    return _combine(data, _like(cfg.bias, data), cfg.operation)


def uniform_noise(data: torch.Tensor, cfg: UniformNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """Apply noise uniform in [``n_min``, ``n_max``) to ``data``, drawn anew for each element."""
    low, high = _like(cfg.n_min, data), _like(cfg.n_max, data)
    sample = torch.rand(data.shape, dtype=data.dtype, device=data.device, generator=generator)
    return _combine(data, low + (high - low) * sample, cfg.operation)


def gaussian_noise(data: torch.Tensor, cfg: GaussianNoiseCfg, generator: torch.Generator | None = None) -> torch.Tensor:
    """Apply normal noise with the mean and standard deviation of ``cfg`` to ``data``, drawn anew for each element."""
    sample = torch.randn(data.shape, dtype=data.dtype, device=data.device, generator=generator)
    return _combine(data, _like(cfg.mean, data) + _like(cfg.std, data) * sample, cfg.operation)


@configclass
class NoiseCfg:
    """Base config of noise: the function that applies it, and the operation."""

    func: Callable[..., torch.Tensor] = MISSING
    """Function called as ``func(data, cfg, generator)``, where the generator may be left out; returns new data of the
    same shape."""

    operation: str = "add"
    """Operation: ``"add"`` is data + noise, ``"scale"`` data * noise, ``"abs"`` the noise in place of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield invalid fields as ``(field, message)``."""
        if self.operation not in _OPERATIONS:
            yield "operation", f"got {self.operation!r}, expected one of {', '.join(map(repr, _OPERATIONS))}"


@configclass
class ConstantNoiseCfg(NoiseCfg):
    """Config of constant noise: the same value for each environment and step."""

    func: Callable[..., torch.Tensor] = constant_noise
    """The function that applies it."""

    bias: Value = 0.0
    """The value, in the unit of the data."""


@configclass
class UniformNoiseCfg(NoiseCfg):
    """Config of uniform noise in [``n_min``, ``n_max``)."""

    func: Callable[..., torch.Tensor] = uniform_noise
    """The function that applies it."""

    n_min: Value = -1.0
    """Lower bound, in the unit of the data."""

    n_max: Value = 1.0
    """Upper bound, in the unit of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield invalid fields as ``(field, message)``."""
        yield from NoiseCfg.problems(self)
        if bool((torch.as_tensor(self.n_min) > torch.as_tensor(self.n_max)).any()):
            yield "n_min", f"is {self.n_min}, above n_max = {self.n_max}"


@configclass
class GaussianNoiseCfg(NoiseCfg):
    """Config of normal (Gaussian) noise."""

    func: Callable[..., torch.Tensor] = gaussian_noise
    """The function that applies it."""

    mean: Value = 0.0
    """Mean, in the unit of the data."""

    std: Value = 1.0
    """Standard deviation, in the unit of the data."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield invalid fields as ``(field, message)``."""
        yield from NoiseCfg.problems(self)
        if bool((torch.as_tensor(self.std) < 0).any()):
            yield "std", f"is {self.std}, must not be negative"


AdditiveUniformNoiseCfg = UniformNoiseCfg
"""Name of :class:`UniformNoiseCfg` in many files of Isaac Lab."""
AdditiveGaussianNoiseCfg = GaussianNoiseCfg
"""Name of :class:`GaussianNoiseCfg` in many files of Isaac Lab."""


class NoiseModel:
    """Noise model without state: the noise of ``noise_cfg``, drawn anew in each call."""

    def __init__(
        self, cfg: NoiseModelCfg, num_envs: int, device: str | torch.device, generator: torch.Generator | None = None
    ):
        """Build the model.

        Args:
            cfg: Config of the model.
            num_envs: Number of environments.
            device: Device of the data.
            generator: Random generator on the same device; None uses torch's default generator.
        """
        self.cfg = cfg
        self.num_envs = num_envs
        self.device = device
        self.generator = generator

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Start a new episode in the environments ``env_ids``; None means all of them."""

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        """Return noisy data; ``data``, shape ``(num_envs, ...)``, is not changed."""
        return _apply(data, self.cfg.noise_cfg, self.generator)


class NoiseModelWithAdditiveBias(NoiseModel):
    """Noise model with a bias: noise drawn in each call, plus a bias that each environment keeps until its reset."""

    cfg: NoiseModelWithAdditiveBiasCfg

    def __init__(
        self,
        cfg: NoiseModelWithAdditiveBiasCfg,
        num_envs: int,
        device: str | torch.device,
        generator: torch.Generator | None = None,
    ):
        """Build the model; arguments as of :class:`NoiseModel`. The first call draws the biases."""
        super().__init__(cfg, num_envs, device, generator)
        self.bias: torch.Tensor | None = None
        """Biases, shape ``(num_envs, ...)`` as the data or ``(num_envs, 1, ...)``; None before the first call."""

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Draw new biases for the environments ``env_ids``; None means all of them."""
        if self.bias is None:
            return
        ids: slice | torch.Tensor = slice(None)
        if env_ids is not None:
            given = env_ids if isinstance(env_ids, torch.Tensor) else torch.tensor(env_ids, dtype=torch.long)
            ids = given.to(self.bias.device)
        self.bias[ids] = self._draw(self.bias[ids])  # in place: a recorded graph may hold its address

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        """Return noisy data plus the biases; ``data``, shape ``(num_envs, ...)``, is not changed."""
        if self.bias is None:
            shape = data.shape if self.cfg.sample_bias_per_component else (data.shape[0],) + (1,) * (data.ndim - 1)
            self.bias = self._draw(torch.zeros(shape, dtype=data.dtype, device=data.device))
        return super().__call__(data) + self.bias

    def _draw(self, like: torch.Tensor) -> torch.Tensor:
        return _apply(torch.zeros_like(like), self.cfg.bias_noise_cfg, self.generator)


@configclass
class NoiseModelCfg:
    """Config of a noise model without state."""

    class_type: type = NoiseModel
    """Class, built as ``class_type(cfg, num_envs, device, generator)``, where the generator may be left out."""

    noise_cfg: NoiseCfg = MISSING
    """The noise of each step."""


@configclass
class NoiseModelWithAdditiveBiasCfg(NoiseModelCfg):
    """Config of a noise model with a bias: noise drawn in each step, plus a bias drawn at each reset."""

    class_type: type = NoiseModelWithAdditiveBias
    """Class, built as ``class_type(cfg, num_envs, device, generator)``, where the generator may be left out."""

    bias_noise_cfg: NoiseCfg = MISSING
    """Noise that the biases are drawn from, applied to zeros."""

    sample_bias_per_component: bool = True
    """Whether each component of the data has its own bias; otherwise all components of an environment share one."""


def _apply(data: torch.Tensor, cfg: NoiseCfg, generator: torch.Generator | None) -> torch.Tensor:
    # Functions of users, written for Isaac Lab, take no generator.
    return cfg.func(data, cfg) if generator is None else cfg.func(data, cfg, generator)


def _like(value: Value, data: torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(value, dtype=data.dtype, device=data.device)


def _combine(data: torch.Tensor, noise: torch.Tensor, operation: str) -> torch.Tensor:
    if operation == "add":
        return data + noise
    if operation == "scale":
        return data * noise
    if operation == "abs":
        return noise.expand(data.shape).clone()  # a copy: the noise may be a config's own tensor
    raise ValueError(f"operation: got {operation!r}, expected one of {', '.join(map(repr, _OPERATIONS))}")
