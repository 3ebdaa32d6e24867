# SPDX-License-Identifier: Apache-2.0
"""Plain networks: the ONNX graph that is written without torch's exporter acts as the policy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from stripe_newton.rl.export.plain_network import plain_onnx

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


def make_policy(activation="elu", normalised=True, distribution="GaussianDistribution"):
    torch.manual_seed(0)
    obs = TensorDict({"policy": torch.randn(64, 5) * 3.0 + 1.0}, batch_size=[64])
    cfg = {"class_name": distribution, "init_std": 1.0}
    policy = MLPModel(obs, {"actor": ["policy"]}, "actor", 3, [16, 8], activation, normalised, cfg)
    policy.update_normalization(obs)
    return policy.eval(), obs


@pytest.mark.parametrize("activation", ["elu", "relu", "tanh", "sigmoid", "softplus"])
@pytest.mark.parametrize("normalised", [True, False])
def test_the_graph_acts_as_the_policy(activation, normalised):
    policy, obs = make_policy(activation, normalised)
    model = plain_onnx(policy, policy.as_onnx(verbose=False))
    assert model is not None
    onnx.checker.check_model(model, full_check=True)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    for count in (1, 64):
        (actions,) = session.run(["actions"], {"obs": obs["policy"][:count].numpy()})
        with torch.no_grad():
            np.testing.assert_allclose(actions, policy(obs[:count]).numpy(), rtol=1e-5, atol=1e-6)


def test_other_networks_are_left_to_torch():
    for policy, _ in (make_policy("swish"), make_policy(distribution="HeteroscedasticGaussianDistribution")):
        assert plain_onnx(policy, policy.as_onnx(verbose=False)) is None

    class Doubled(MLPModel):
        def forward(self, *args, **kwargs):
            return 2.0 * super().forward(*args, **kwargs)

    policy, _ = make_policy()
    policy.__class__ = Doubled
    assert plain_onnx(policy, policy.as_onnx(verbose=False)) is None
