# SPDX-License-Identifier: Apache-2.0
"""Noise models and modifiers of the Isaac Lab dialect: their formulas in NumPy and SciPy, and Isaac Lab's own files."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from stripe_newton.isaaclab import modifiers, noise
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, UniformNoiseCfg
from tests.helpers.isaaclab_source import isaaclab_modules

STEPS, SHAPE = 12, (3, 2)
A, B = [-0.6, 0.2], [0.3, 0.5, -0.1]
DT = 0.02
SIGNAL = np.random.default_rng(4).normal(size=(STEPS, *SHAPE))


def filtered(make: type, cfg: object, reset_at: int | None = None) -> np.ndarray:
    """Outputs of a modifier over the signal; environment 1 is reset before one of its steps."""
    modifier = make(cfg, SHAPE, "cpu")
    found = []
    for step, values in enumerate(SIGNAL):
        if step == reset_at:
            modifier.reset(torch.tensor([1]))
        found.append(modifier(torch.tensor(values, dtype=torch.float32)).numpy().copy())
    return np.array(found)


def test_a_digital_filter_is_that_of_scipy():
    found = filtered(modifiers.DigitalFilter, modifiers.DigitalFilterCfg(A=A, B=B), reset_at=5)
    expected = lfilter(B, [1.0, *A], SIGNAL, axis=0)
    expected[5:, 1] = lfilter(B, [1.0, *A], SIGNAL[5:, 1], axis=0)
    np.testing.assert_allclose(found, expected, atol=5e-6)


def test_an_integrator_is_the_trapezoidal_rule():
    found = filtered(modifiers.Integrator, modifiers.IntegratorCfg(dt=DT), reset_at=5)
    before = np.zeros((1, *SHAPE))
    expected = cumulative_trapezoid(np.concatenate((before, SIGNAL)), dx=DT, axis=0)
    expected[5:, 1] = cumulative_trapezoid(np.concatenate((before[:, 1], SIGNAL[5:, 1])), dx=DT, axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_functions_that_modify():
    data = torch.tensor([[-2.0, 0.5], [3.0, 7.0]])
    assert modifiers.scale(data, 2.0).tolist() == [[-4.0, 1.0], [6.0, 14.0]]
    assert modifiers.bias(data, 1.0).tolist() == [[-1.0, 1.5], [4.0, 8.0]]
    assert modifiers.clip(data, (-1.0, 4.0)).tolist() == [[-1.0, 0.5], [3.0, 4.0]]
    assert modifiers.clip(data, (None, 1.0)).tolist() == [[-2.0, 0.5], [1.0, 1.0]]


@pytest.mark.parametrize(("operation", "biases"), [("abs", [0.5, 0.5, 0.5]), ("add", [1.5, 1.5, 1.0])])
def test_a_bias_is_drawn_by_resets(operation, biases):
    """With "add", as Isaac Lab has it, biases add up: the first call draws once, each reset once more."""
    cfg = noise.NoiseModelWithAdditiveBiasCfg(
        noise_cfg=ConstantNoiseCfg(bias=2.0), bias_noise_cfg=ConstantNoiseCfg(bias=0.5, operation=operation)
    )
    model = noise.NoiseModelWithAdditiveBias(cfg, 3, "cpu")
    data = torch.ones(3, 2)
    assert model(data).tolist() == [[3.5, 3.5]] * 3
    model.reset()
    model.reset(torch.tensor([0, 1]))
    assert model(data).tolist() == [[3.0 + bias] * 2 for bias in biases]
    assert data.tolist() == [[1.0, 1.0]] * 3


# -- beside Isaac Lab's own files


@pytest.fixture(scope="module")
def theirs() -> Iterator[SimpleNamespace]:
    with isaaclab_modules(
        "isaaclab.utils.modifiers.modifier", "isaaclab.utils.noise.noise_model", "isaaclab.utils.noise.noise_cfg"
    ) as (modifier, model, cfg):
        yield SimpleNamespace(modifier=modifier, model=model, cfg=cfg)


@pytest.mark.parametrize("kind", ["DigitalFilter", "Integrator"])
def test_modifiers_give_the_same_as_isaac_labs(theirs, kind):
    numbers = {"A": A, "B": B} if kind == "DigitalFilter" else {"dt": DT}
    cfg = getattr(modifiers, f"{kind}Cfg")(**numbers)
    class_of_theirs = getattr(theirs.modifier, kind)
    # Isaac Lab's own results begin in the memory of the filter, which later steps overwrite: filtered() copies.
    expected = filtered(class_of_theirs, SimpleNamespace(**numbers), reset_at=5)
    np.testing.assert_allclose(filtered(getattr(modifiers, kind), cfg, reset_at=5), expected, atol=5e-6)


@pytest.mark.parametrize("operation", ["add", "scale", "abs"])
@pytest.mark.parametrize(
    "cfg", [UniformNoiseCfg(n_min=-0.5, n_max=1.5), GaussianNoiseCfg(mean=0.3, std=0.2), ConstantNoiseCfg(bias=0.7)]
)
def test_noise_of_a_seed_is_that_of_isaac_lab(theirs, cfg, operation):
    name = {"UniformNoiseCfg": "uniform", "GaussianNoiseCfg": "gaussian", "ConstantNoiseCfg": "constant"}
    cfg = cfg.replace(operation=operation)
    function = getattr(theirs.model, f"{name[type(cfg).__name__]}_noise")
    data = torch.linspace(-1.0, 1.0, 40).view(8, 5)
    torch.manual_seed(2)
    expected = function(data.clone(), cfg)
    torch.manual_seed(2)
    torch.testing.assert_close(cfg.func(data.clone(), cfg), expected)
