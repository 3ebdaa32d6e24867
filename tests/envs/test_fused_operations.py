# SPDX-License-Identifier: Apache-2.0
"""Fused operations of torch hooks: each gives what torch gives, with types, views, broadcasts and writes in place."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.envs.hook_graphs.fused import trusted
from stripe_newton.envs.hook_graphs.fused.function_check import differing_functions
from tests.helpers.fused import Fused, compile_for_gpu, gpu_codes, run_fused
from tests.helpers.fused_cases import CLOSE, EXACT, N, P, X, leaves


@pytest.fixture(scope="module")
def fused() -> dict[str, Fused]:
    return run_fused(EXACT | CLOSE, N)


def bits(value: torch.Tensor) -> torch.Tensor:
    return value.contiguous().view(torch.uint8)


def test_results_are_those_of_torch(fused):
    for name, function in EXACT.items():
        for index, (found, expected) in enumerate(zip(leaves(fused[name].result), leaves(function()), strict=True)):
            assert found.dtype == expected.dtype, (name, index)
            assert found.stride() == expected.stride(), (name, index)
            same = torch.equal(found, expected) or torch.equal(bits(found), bits(expected))
            assert same or torch.equal(found.nan_to_num(7.0), expected.nan_to_num(7.0)), (name, index, found, expected)


def test_functions_differ_in_the_last_digits_at_most(fused):
    for name, function in CLOSE.items():
        for found, expected in zip(leaves(fused[name].result), leaves(function()), strict=True):
            torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6, msg=name)


@pytest.mark.parametrize("name", [*EXACT, *CLOSE])
def test_each_function_is_one_kernel(fused, name):
    run = fused[name]
    assert [a for a in run.traced.alone if not a.startswith(("empty", "arange"))] == []
    assert len(run.launched.codes) == (2 if name == "written_by_indices" else 1)  # no row may read what others write
    assert run.launched.operations == run.traced.operations


@pytest.mark.slow
def test_functions_that_differ_are_found_and_left_to_torch(monkeypatch):
    """As on a GPU whose library of functions is another one than torch's; on a CPU torch has functions of its own."""
    differing = differing_functions("cpu")
    arithmetic = {"add", "sub", "mul", "div", "neg", "abs", "sign", "square", "maximum", "minimum", "clamp", "floor"}
    assert not differing & arithmetic
    monkeypatch.setattr(trusted, "_DIFFERING", {torch.device("cpu"): frozenset({"sin", "pow"})})
    run = run_fused({"both": lambda: (X.sin() * 2.0 + X**2, P**1.5 + 1.0)}, N)["both"]
    assert run.traced.alone == ["sin rounds differently here", "pow.Tensor_Scalar rounds differently here"]
    for found, expected in zip(run.result, (X.sin() * 2.0 + X**2, P**1.5 + 1.0), strict=True):
        assert torch.equal(found, expected)


@pytest.mark.slow
def test_code_for_gpus_compiles(tmp_path):
    """NVRTC needs no GPU. The code for one differs from that for the CPU: it calls intrinsics."""
    codes = gpu_codes(EXACT | CLOSE, N)
    assert any("__fmul_rn" in code.body for code in codes)
    text = compile_for_gpu(codes, tmp_path)
    assert text.count(".entry") == len(codes)
    assert "fma.rn.f32" in text  # where torch contracts, as in cross products
