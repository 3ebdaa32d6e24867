# SPDX-License-Identifier: Apache-2.0
"""Layer kernels: a linear layer with ELU, and the gradient through both, by a library's matrix product or by Triton."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
import warp as wp

from stripe_kernels.ppo import BLOCK, elu_gradient, elu_gradient_bf16

from .flat_adam import as_array
from .fused_layers import BLOCK_ROWS, elu_layer, elu_layer_gradient
from .program import Program

__all__ = ["LIBRARY", "TRITON", "LayerKernels", "elu_gradient_in_torch", "elu_gradient_in_warp", "layer_kernels"]

_ROWS = 64
"""Samples that one thread of the ELU's gradient adds up: enough threads for a GPU, few sums to add afterwards."""


@dataclass(frozen=True)
class LayerKernels:
    """Functions that compute layers with ELU."""

    layer: Callable[[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
    """``elu(x @ weight.T + bias)`` of inputs ``(m, k)``, weights ``(n, k)`` and biases ``(n,)``."""
    gradient: Callable[[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
    """Gradient through a layer and the ELU before it, of the gradient by the layer's output ``(m, k)``, its weights
    ``(k, n)``, its inputs ``(m, n)``, and float32 memory ``(blocks, n)``, which takes the sums of the result over the
    samples of each block."""
    rows: int
    """Samples in a block."""


def _layer(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.elu_(torch.addmm(bias, x, weight.t()))


def _gradient(
    grad_output: torch.Tensor, weight: torch.Tensor, result: torch.Tensor, sums: torch.Tensor
) -> torch.Tensor:
    grad_input = grad_output @ weight
    packed = grad_input.dtype != torch.bfloat16 or grad_input.shape[1] % 2 == 0
    (elu_gradient_in_warp if grad_input.is_cuda and packed else elu_gradient_in_torch)(grad_input, result, sums)
    return grad_input


def elu_gradient_in_torch(gradient: torch.Tensor, result: torch.Tensor, sums: torch.Tensor) -> None:
    """Turn the gradient behind an ELU into that before it, by torch, which uses all threads of a CPU.

    Args:
        gradient: By the results; becomes that by the arguments, ``(samples, width)``.
        result: Results of the ELU, ``(samples, width)``.
        sums: Takes the sums of the new gradient over all samples in its first row, float32, ``(blocks, width)``.
    """
    torch.ops.aten.elu_backward.grad_input(gradient, 1.0, 1.0, 1.0, True, result, grad_input=gradient)
    torch.sum(gradient, dim=0, dtype=torch.float32, out=sums[0])
    sums[1:].zero_()


def elu_gradient_in_warp(gradient: torch.Tensor, result: torch.Tensor, sums: torch.Tensor) -> None:
    """:func:`elu_gradient_in_torch` in one pass, with the sums of each block. In bfloat16 the width must be even."""
    kernel, views, dtype = elu_gradient, (gradient, result), wp.float32
    if gradient.dtype == torch.bfloat16:
        # Two numbers in a word: loads of 16 bits would leave half of the memory's bandwidth unused.
        kernel, views, dtype = elu_gradient_bf16, (gradient.view(torch.int32), result.view(torch.int32)), wp.uint32
    arrays = [wp.from_torch(t, dtype=dtype, requires_grad=False) for t in views]
    wp.launch(
        kernel,
        dim=(len(sums), arrays[0].shape[1]),
        inputs=[*arrays, _ROWS, as_array(sums)],
        device=arrays[0].device,
        block_dim=BLOCK,
    )


LIBRARY = LayerKernels(_layer, _gradient, _ROWS)
"""Matrix products of torch's library, and passes over their results."""
TRITON = LayerKernels(elu_layer, elu_layer_gradient, BLOCK_ROWS)
"""One kernel for a layer."""


def layer_kernels(device: torch.device, kind: torch.dtype) -> LayerKernels:
    """The fastest functions on a device.

    Triton's are taken if the environment variable ``STRIPE_NEWTON_TRITON`` is 1, on a GPU and not for products in
    float32.
    """
    exact = kind == torch.float32 and torch.get_float32_matmul_precision() == "highest"
    if device.type != "cuda" or exact or os.environ.get("STRIPE_NEWTON_TRITON") != "1":
        return LIBRARY
    return TRITON if _why_no_triton(device, kind) == "" else LIBRARY


@cache
def _why_no_triton(device: torch.device, kind: torch.dtype) -> str:
    """Reason why Triton's kernels cannot be used, which is also printed; empty if they can."""
    x, weight, grad_output = (
        torch.rand(shape, device=device).to(kind) - 0.5 for shape in ((128, 32), (64, 32), (128, 64))
    )
    sums = torch.zeros(2, 2, 32, device=device)
    found, problem = list[tuple[torch.Tensor, torch.Tensor]](), ""

    def compute() -> None:
        for way, parts in zip((LIBRARY, TRITON), sums, strict=True):
            parts = parts[: 128 // way.rows]
            found.append((way.layer(x, weight, weight[:, 0].contiguous()), way.gradient(grad_output, weight, x, parts)))

    try:
        Program(compute, device).run()  # on a stream that torch and Warp share
        pairs = [*zip(*found, strict=True), tuple(sums.sum(dim=1))]
        if any(not torch.allclose(one.float(), two.float(), rtol=0.05, atol=0.05) for one, two in pairs):
            problem = "its results are wrong"
    except Exception as error:  # of its compilers, of which each has errors of its own
        problem = str(error).strip().split("\n")[-1] or type(error).__name__
    if problem:
        print(f"Triton's kernels are not used, which costs speed alone: {problem}", file=sys.stderr)
    return problem
