# SPDX-License-Identifier: Apache-2.0
"""Network pass: gradients of networks in an update, against torch's autograd."""

import pytest
import torch
import warp as wp
from rsl_rl.models import CNNModel, MLPModel
from tensordict import TensorDict

from stripe_newton.rl.graphs.layer_kernels import elu_gradient_in_torch, elu_gradient_in_warp
from stripe_newton.rl.graphs.network_pass import EluPass, TorchPass, network_pass

SAMPLES = 150
PICKED = torch.arange(SAMPLES).flip(0)

wp.init()


def model(**settings) -> MLPModel:
    torch.manual_seed(3)
    obs = TensorDict({"a": torch.zeros(1, 5), "b": torch.zeros(1, 3)}, batch_size=[1])
    made = MLPModel(obs, {"actor": ["a", "b"]}, "actor", 4, **({"hidden_dims": (16, 10)} | settings))
    for parameter in made.parameters():
        parameter.grad = torch.zeros_like(parameter)
    if made.obs_normalization:
        made.update_normalization(TensorDict({"a": torch.randn(20, 5) + 1.0, "b": torch.rand(20, 3)}, batch_size=[20]))
    return made


def observations() -> TensorDict:
    torch.manual_seed(4)
    groups = {"a": torch.randn(SAMPLES, 5), "b": torch.randn(SAMPLES, 3)}
    return TensorDict(groups, batch_size=[SAMPLES], device="cpu")


def gradients(of: MLPModel) -> dict[str, torch.Tensor]:
    found = {name: p.grad.clone() for name, p in of.named_parameters()}
    of.zero_grad(set_to_none=False)
    return found


@pytest.mark.parametrize("settings", [{}, {"obs_normalization": True}, {"hidden_dims": (8,)}], ids=str)
@pytest.mark.parametrize("bf16", [False, True])
def test_the_gradients_are_those_of_autograd(settings, bf16):
    network, obs = model(**settings), observations()
    grad_output = torch.randn(SAMPLES, 4)
    ours = network_pass(network, {p: p.detach().bfloat16() for p in network.parameters()} if bf16 else None)
    assert isinstance(ours, EluPass)
    output = ours.forward(obs, PICKED)
    ours.backward(grad_output)
    found = gradients(network)
    theirs = network(obs[PICKED])
    theirs.backward(grad_output)
    # bfloat16 has 8 bits; errors of many samples cancel.
    tolerance = {"rtol": 0.05, "atol": 0.02 * SAMPLES**0.5} if bf16 else {"rtol": 1.0e-5, "atol": 1.0e-5}
    torch.testing.assert_close(output, theirs.detach(), rtol=tolerance["rtol"], atol=0.05 if bf16 else 1.0e-6)
    for name, value in gradients(network).items():
        torch.testing.assert_close(found[name], value, **tolerance, msg=lambda m, n=name: f"{n}: {m}")


@pytest.mark.parametrize("activation", ["relu", "tanh", "crelu"])
def test_other_networks_run_by_autograd(activation):
    network, obs = model(activation=activation), observations()
    ours = network_pass(network)
    assert isinstance(ours, TorchPass)
    grad_output = torch.randn(SAMPLES, 4)
    torch.testing.assert_close(ours.forward(obs, PICKED), network(obs[PICKED]).detach())
    ours.backward(grad_output)
    found = gradients(network)
    network(obs[PICKED]).backward(grad_output)
    for name, value in gradients(network).items():
        torch.testing.assert_close(found[name], value, msg=lambda m, n=name: f"{n}: {m}")


@pytest.mark.parametrize("groups", [["picture"], ["a", "picture"]], ids=str)
def test_networks_of_pictures_get_their_pictures(groups):
    """rsl_rl keeps the groups of pictures apart from those that are vectors."""
    torch.manual_seed(3)
    obs = TensorDict({"a": torch.randn(9, 5), "picture": torch.rand(9, 1, 12, 12)}, batch_size=[9])
    cnn = {"output_channels": (4,), "kernel_size": 3, "stride": 2}
    network = CNNModel(obs, {"actor": groups}, "actor", 4, (8,), cnn_cfg=cnn)
    ours, rows = network_pass(network), torch.arange(9).flip(0)
    torch.testing.assert_close(ours.forward(obs, rows), network(obs[rows]).detach())


@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16], ids=str)
def test_the_kernel_of_the_elu_is_torchs(kind):
    torch.manual_seed(5)
    result = torch.nn.functional.elu(torch.randn(SAMPLES, 14)).to(kind)
    gradient = torch.randn(SAMPLES, 14).to(kind)
    theirs, ours = gradient.clone(), gradient.clone()
    their_sums, our_sums = torch.zeros(2, 3, 14)
    elu_gradient_in_torch(theirs, result, their_sums)
    elu_gradient_in_warp(ours, result, our_sums)
    torch.testing.assert_close(ours, theirs, rtol=0.0, atol=0.0)
    torch.testing.assert_close(our_sums.sum(dim=0), their_sums.sum(dim=0), rtol=1.0e-5, atol=1.0e-5)
