# SPDX-License-Identifier: Apache-2.0
"""stripe_newton.noise: distributions, how noise enters the data, and the memory of a bias."""

from __future__ import annotations

import math

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.noise import (
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseCfg,
    NoiseModelCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)

N, M = 4096, 8


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def build(cfg, num_envs=N, seed=0):
    return cfg.class_type(cfg, num_envs, "cpu", generator(seed))


@pytest.mark.parametrize(("operation", "expected"), [("add", 5.0), ("scale", 6.0), ("abs", 3.0)])
def test_operations(operation, expected):
    data = torch.full((4, 2), 2.0)
    cfg = ConstantNoiseCfg(bias=3.0, operation=operation)
    out = cfg.func(data, cfg)
    assert torch.equal(out, torch.full((4, 2), expected))
    assert torch.equal(data, torch.full((4, 2), 2.0))
    out[0] = 0.0  # a result has memory of its own
    assert out[1, 0] == expected


def test_values_broadcast():
    cfg = ConstantNoiseCfg(bias=torch.tensor([1.0, 2.0]), operation="abs")
    assert torch.equal(cfg.func(torch.zeros(3, 2), cfg), torch.tensor([[1.0, 2.0]] * 3))


@pytest.mark.parametrize("operation", ["add", "scale", "abs"])
def test_uniform_statistics(operation):
    cfg = UniformNoiseCfg(n_min=-0.5, n_max=1.5, operation=operation)
    out = cfg.func(torch.full((N, M), 4.0), cfg, generator())
    noise = {"add": out - 4.0, "scale": out / 4.0, "abs": out}[operation]
    count = N * M
    assert noise.min() >= -0.5
    assert noise.max() <= 1.5
    assert abs(noise.mean().item() - 0.5) < 5 * 2.0 / math.sqrt(12 * count)
    assert abs(noise.var().item() - 4.0 / 12) < 5 * 4.0 / math.sqrt(180 * count)


def test_gaussian_statistics():
    cfg = GaussianNoiseCfg(mean=1.0, std=0.25)
    noise = cfg.func(torch.full((N, M), -3.0), cfg, generator()) + 3.0
    count = N * M
    assert abs(noise.mean().item() - 1.0) < 5 * 0.25 / math.sqrt(count)
    assert abs(noise.std().item() - 0.25) < 5 * 0.25 / math.sqrt(2 * count)


@pytest.mark.parametrize("cfg", [UniformNoiseCfg(), GaussianNoiseCfg()], ids=["uniform", "gaussian"])
def test_seeds_hold(cfg):
    data = torch.zeros(N, M)
    assert torch.equal(cfg.func(data, cfg, generator(3)), cfg.func(data, cfg, generator(3)))
    assert not torch.equal(cfg.func(data, cfg, generator(3)), cfg.func(data, cfg, generator(4)))
    torch.manual_seed(5)
    first = cfg.func(data, cfg)
    torch.manual_seed(5)
    assert torch.equal(cfg.func(data, cfg), first)


def test_model_draws_anew_each_call():
    model = build(NoiseModelCfg(noise_cfg=GaussianNoiseCfg()))
    data = torch.zeros(N, M)
    assert not torch.equal(model(data), model(data))
    model.reset()
    model.reset([0, 1])
    assert torch.equal(data, torch.zeros(N, M))


def test_a_function_of_two_arguments_will_do():
    cfg = NoiseModelCfg(noise_cfg=NoiseCfg(func=lambda data, cfg: data + 1.0))
    model = cfg.class_type(cfg, 2, "cpu")
    assert torch.equal(model(torch.zeros(2, 3)), torch.ones(2, 3))


def bias_only(per_component: bool) -> NoiseModelWithAdditiveBiasCfg:
    return NoiseModelWithAdditiveBiasCfg(
        noise_cfg=ConstantNoiseCfg(bias=0.0),
        bias_noise_cfg=UniformNoiseCfg(n_min=-1.0, n_max=1.0),
        sample_bias_per_component=per_component,
    )


def test_bias_stays_until_its_environment_is_reset():
    model = build(bias_only(per_component=True))
    data = torch.zeros(N, M)
    first = model(data)
    assert torch.equal(model(data), first)
    assert torch.equal(model(data + 2.0), first + 2.0)
    ids = torch.tensor([3, 100, 4095])
    model.reset(ids)
    second = model(data)
    changed = (second != first).any(dim=1).nonzero().squeeze(1)
    assert torch.equal(changed, ids)
    model.reset([])
    assert torch.equal(model(data), second)
    model.reset()
    assert (model(data) != second).any(dim=1).all()
    assert torch.equal(data, torch.zeros(N, M))


def test_bias_per_component_or_per_environment():
    data = torch.zeros(N, M)
    each = build(bias_only(per_component=True))(data)
    assert (each != each[:, :1]).any()
    assert abs(each.mean().item()) < 5 * 2.0 / math.sqrt(12 * N * M)
    one = build(bias_only(per_component=False))(data)
    assert torch.equal(one, one[:, :1].expand(N, M))
    assert len(one[:, 0].unique()) > 0.99 * N


def test_bias_and_noise_add_up():
    cfg = bias_only(per_component=True).replace(noise_cfg=GaussianNoiseCfg(mean=0.0, std=0.1))
    model = build(cfg)
    data = torch.zeros(N, M)
    noise = model(data) - model.bias
    assert abs(noise.std().item() - 0.1) < 5 * 0.1 / math.sqrt(2 * N * M)


def test_models_repeat_with_their_seed():
    data = torch.zeros(N, M)
    runs = []
    for seed in (1, 1, 2):
        model = build(bias_only(per_component=True), seed=seed)
        model(data)
        model.reset(torch.arange(0, N, 2))
        runs.append(model(data))
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])


def test_a_wrong_config_is_reported_whole():
    cfg = NoiseModelWithAdditiveBiasCfg(
        noise_cfg=UniformNoiseCfg(n_min=1.0, n_max=0.0, operation="plus"), bias_noise_cfg=GaussianNoiseCfg(std=-1.0)
    )
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    assert [p.split(":")[0] for p in error.value.problems] == [
        "noise_cfg.operation",
        "noise_cfg.n_min",
        "bias_noise_cfg.std",
    ]
    with pytest.raises(ConfigError, match=r"noise_cfg: is missing"):
        NoiseModelCfg().validate()
