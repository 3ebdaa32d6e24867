# SPDX-License-Identifier: Apache-2.0
"""Convolutions in the forms of a GPU, against rsl_rl's own modules."""

from __future__ import annotations

import pytest
import torch
import warp as wp
from rsl_rl.models import CNNModel
from tensordict import TensorDict

from stripe_kernels.pictures import gather_blocks
from stripe_newton.rl.graphs import picture_layers
from stripe_newton.rl.graphs.flat_adam import as_array
from stripe_newton.rl.graphs.network_pass import network_output, network_pass
from stripe_newton.rl.graphs.picture_layers import PLAIN, PictureForm, convolve, convolve_rows, fast_form

FORMS = [PictureForm(blocks, last) for blocks in (False, True) for last in (False, True)]
wp.init()  # GraphPPO has done it

NATURE = {"output_channels": (8, 16, 16), "kernel_size": (8, 4, 3), "stride": (4, 2, 1)}


def network(groups: list[str], cnn: dict, size: int = 48) -> tuple[CNNModel, TensorDict]:
    torch.manual_seed(3)
    parts = {"a": torch.randn(9, 5), "left": torch.rand(9, 3, size, size), "right": torch.rand(9, 1, size, 40)}
    obs = TensorDict(parts, batch_size=[9])
    return CNNModel(obs, {"actor": groups}, "actor", 4, (8,), cnn_cfg=cnn), obs


def gradients(model: CNNModel) -> list[torch.Tensor]:
    found = [parameter.grad.clone() for parameter in model.parameters()]
    model.zero_grad(set_to_none=False)
    return found


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("cnn", [NATURE, NATURE | {"activation": "relu"}, NATURE | {"padding": "zeros"}], ids=str)
def test_forms_give_the_numbers_and_gradients_of_the_modules(form, cnn):
    model, obs = network(["left"], cnn)
    layers = model.cnns["left"]
    theirs = layers(obs["left"])
    weights = torch.randn_like(theirs)
    (theirs * weights).sum().backward()
    their_gradients = [p.grad.clone() for p in layers.parameters()]
    layers.zero_grad()
    ours = convolve(layers, obs["left"], form)
    (ours * weights).sum().backward()
    torch.testing.assert_close(ours, theirs, rtol=1.0e-4, atol=1.0e-5)
    for parameter, value in zip(layers.parameters(), their_gradients, strict=True):
        torch.testing.assert_close(parameter.grad, value, rtol=1.0e-4, atol=2.0e-5)


@pytest.mark.parametrize("bf16", [False, True])
def test_rows_are_gathered_as_blocks(bf16):
    torch.manual_seed(4)
    model, _ = network(["right"], NATURE)
    layers, rows = model.cnns["right"], torch.tensor([5, 0, 5, 8])
    stored = torch.rand(9, 1, 48, 40)
    form = PictureForm(blocks=True, channels_last=True)
    with torch.autocast("cpu", torch.bfloat16, bf16):
        ours, theirs = convolve_rows(layers, stored, rows, form, bf16), layers(stored[rows])
    near = {"rtol": 2.0e-2, "atol": 2.0e-2} if bf16 else {"rtol": 1.0e-4, "atol": 1.0e-5}
    torch.testing.assert_close(ours, theirs, **near)
    # Of steps of a rollout that are not next to each other in memory.
    apart = torch.rand(9, 2, 1, 48, 40)[:, 1]
    torch.testing.assert_close(
        convolve_rows(layers, apart, rows, form, False), layers(apart[rows]), rtol=1e-4, atol=1e-5
    )


def test_blocks_are_those_of_pixel_unshuffle():
    torch.manual_seed(5)
    stored, rows = torch.randn(6, 3, 12, 20), torch.tensor([4, 1, 1])
    out = torch.zeros(3, 3 * 12 * 20)
    inputs = [as_array(t) for t in (rows, stored.flatten(1))]
    wp.launch(gather_blocks, dim=(3, 3 * 12 * 20 // 4), inputs=[*inputs, 3, 12, 20, 4, as_array(out)], device="cpu")
    theirs = torch.nn.functional.pixel_unshuffle(stored[rows], 4)
    assert torch.equal(out.view(3, 3, 5, 48).permute(0, 3, 1, 2), theirs)


def test_a_size_that_the_stride_does_not_divide_keeps_the_module():
    model, obs = network(["left"], NATURE, size=49)
    form = PictureForm(blocks=True, channels_last=True)
    ours = convolve(model.cnns["left"], obs["left"], form)
    torch.testing.assert_close(ours, model.cnns["left"](obs["left"]), rtol=1.0e-4, atol=1.0e-5)


@pytest.mark.parametrize("groups", [["left"], ["a", "right", "left"]], ids=str)
def test_networks_use_the_form_of_their_device(groups, monkeypatch):
    model, obs = network(groups, NATURE)
    for parameter in model.parameters():
        parameter.grad = torch.zeros_like(parameter)
    forms = []
    monkeypatch.setattr(picture_layers, "fast_form", lambda device: forms.append(device) or FORMS[3])
    rows, grad_output = torch.arange(9).flip(0), torch.randn(9, 4)
    ours = network_pass(model)
    torch.testing.assert_close(ours.forward(obs, rows), model(obs[rows]).detach(), rtol=1.0e-4, atol=1.0e-5)
    ours.backward(grad_output)
    found = gradients(model)
    model(obs[rows]).backward(grad_output)
    for value, theirs in zip(found, gradients(model), strict=True):
        torch.testing.assert_close(value, theirs, rtol=1.0e-4, atol=2.0e-5)
    torch.testing.assert_close(network_output(model, obs), model(obs).detach(), rtol=1.0e-4, atol=1.0e-5)
    assert len(forms) == 2


def test_the_cpu_and_those_who_ask_for_it_keep_the_modules(monkeypatch):
    gpu = torch.device("cuda", 0)
    monkeypatch.delenv("STRIPE_NEWTON_PLAIN_CONVOLUTIONS", raising=False)
    assert fast_form(torch.device("cpu")) == PLAIN != fast_form(gpu)
    monkeypatch.setenv("STRIPE_NEWTON_PLAIN_CONVOLUTIONS", "1")
    assert fast_form(gpu) == PLAIN
