# SPDX-License-Identifier: Apache-2.0
"""Fused layers: a linear layer with its ELU, and the gradient through both, each one kernel of Triton.

A library's matrix product leaves the ELU to a pass of its own over the activations. On a GPU that pass takes longer
than the product, so here it is done where the product's results are still in registers.
"""

# mypy: disable-error-code="no-untyped-def"
# No `from __future__ import annotations`: Triton reads them.
import torch

try:
    import triton
    import triton.language as tl
except ModuleNotFoundError:  # torch brings it where it can be of use
    triton = tl = None

__all__ = ["BLOCK_ROWS", "elu_layer", "elu_layer_gradient"]

BLOCK_ROWS = 128
"""Samples in a block, of which :func:`elu_layer_gradient` gives the sums."""
_COLUMNS = 128


if triton is not None:

    @triton.jit
    def _layer(x, weight, bias, out, m, n, k, BM: tl.constexpr, BN: tl.constexpr, BK: tl.constexpr):
        """A block of ``elu(x @ weight.T + bias)``."""
        columns = tl.cdiv(n, BN)
        # Neighbours read the same rows of `x`, which is large; `weight` stays in the cache.
        rm = (tl.program_id(0) // columns) * BM + tl.arange(0, BM)
        rn = (tl.program_id(0) % columns) * BN + tl.arange(0, BN)
        total = tl.zeros((BM, BN), dtype=tl.float32)
        for start in range(0, k, BK):
            rk = start + tl.arange(0, BK)
            left = tl.load(x + rm[:, None] * k + rk[None, :], mask=(rm[:, None] < m) & (rk[None, :] < k), other=0.0)
            right = tl.load(
                weight + rn[None, :] * k + rk[:, None], mask=(rn[None, :] < n) & (rk[:, None] < k), other=0.0
            )
            total = tl.dot(left, right, total, input_precision="tf32")
        total += tl.load(bias + rn, mask=rn < n, other=0.0).to(tl.float32)[None, :]
        total = tl.where(total > 0.0, total, tl.exp(total) - 1.0)
        tl.store(
            out + rm[:, None] * n + rn[None, :],
            total.to(out.dtype.element_ty),
            mask=(rm[:, None] < m) & (rn[None, :] < n),
        )

    @triton.jit
    def _gradient(
        grad_output, weight, result, grad_input, sums, m, n, k, to_block, to_k, to_n,
        BM: tl.constexpr, BN: tl.constexpr, BK: tl.constexpr,
    ):  # fmt: skip
        """A block of ``(grad_output @ weight) * slope(result)``, and its sums over the rows."""
        columns = tl.cdiv(n, BN)
        block = tl.program_id(0) // columns
        rm = block * BM + tl.arange(0, BM)
        rn = (tl.program_id(0) % columns) * BN + tl.arange(0, BN)
        total = tl.zeros((BM, BN), dtype=tl.float32)
        for start in range(0, k, BK):
            rk = start + tl.arange(0, BK)
            left = tl.load(
                grad_output + rm[:, None] * k + rk[None, :], mask=(rm[:, None] < m) & (rk[None, :] < k), other=0.0
            )
            right = tl.load(
                weight + rk[:, None] * to_k + rn[None, :] * to_n, mask=(rk[:, None] < k) & (rn[None, :] < n), other=0.0
            )
            total = tl.dot(left, right, total, input_precision="tf32")
        inside = (rm[:, None] < m) & (rn[None, :] < n)
        place = rm[:, None] * n + rn[None, :]
        slope = tl.load(result + place, mask=inside, other=0.0).to(tl.float32)
        total = (total * tl.where(slope > 0.0, 1.0, slope + 1.0)).to(grad_input.dtype.element_ty)
        tl.store(grad_input + place, total, mask=inside)
        tl.store(sums + block * to_block + rn, tl.sum(total.to(tl.float32), axis=0), mask=rn < n)


def _grid(rows: int, columns: int) -> tuple[int]:
    return (triton.cdiv(rows, BLOCK_ROWS) * triton.cdiv(columns, _COLUMNS),)


def _settings(x: torch.Tensor) -> dict[str, int]:
    deep = 64 if x.dtype == torch.bfloat16 else 32
    return {"BM": BLOCK_ROWS, "BN": _COLUMNS, "BK": deep, "num_warps": 8, "num_stages": 3}


def elu_layer(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    """``elu(x @ weight.T + bias)``, products in TF32 or bfloat16.

    Args:
        x: Inputs, contiguous, ``(m, k)``, float32 or bfloat16.
        weight: Weights, contiguous, ``(n, k)``.
        bias: Biases, ``(n,)``.

    Returns:
        Activations, ``(m, n)``.
    """
    (m, k), n = x.shape, len(weight)
    out = torch.empty(m, n, dtype=x.dtype, device=x.device)
    with torch.cuda.device_of(x):  # Triton launches on the current device
        _layer[_grid(m, n)](x, weight, bias, out, m, n, k, **_settings(x))
    return out


def elu_layer_gradient(
    grad_output: torch.Tensor, weight: torch.Tensor, result: torch.Tensor, sums: torch.Tensor
) -> torch.Tensor:
    """Gradient through a linear layer and the ELU before it.

    Args:
        grad_output: Gradient by the layer's output, contiguous, ``(m, k)``.
        weight: Weights of the layer, contiguous, ``(k, n)``.
        result: Results of the ELU, the layer's inputs, contiguous, ``(m, n)``.
        sums: Takes the gradient's sums over the samples of each block, float32, rows contiguous, ``(blocks, n)``.

    Returns:
        Gradient by the arguments of the ELU, ``(m, n)``.
    """
    (m, n), k = result.shape, len(weight)
    grad_input = torch.empty_like(result)
    if result.dtype == torch.float32:
        # In TF32 the tensor cores take both factors only with the summed index innermost.
        weight = weight.t().contiguous().t()
    strides = (sums.stride(0), *weight.stride())
    with torch.cuda.device_of(result):
        _gradient[_grid(m, n)](grad_output, weight, result, grad_input, sums, m, n, k, *strides, **_settings(result))
    return grad_input
