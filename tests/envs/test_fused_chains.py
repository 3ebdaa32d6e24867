# SPDX-License-Identifier: Apache-2.0
"""Chains of fused operations: where they break, as no thread may read what another one writes, and what they write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
import warp as wp

from stripe_newton.envs.hook_graphs.fused import chain, chain_kernels
from stripe_newton.envs.hook_graphs.fused.fusing_mode import FusingMode, NotFusible
from tests.helpers.fused import Fused, compile_for_gpu, gpu_codes, run_fused

N, RESETS = 24, 7


class State:
    """Memory that functions read and write in place; ``wide`` and ``part`` overlap as arrays of a simulation may."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(3)
        self.x, self.y, self.wide = (torch.randn(N, k, generator=generator) for k in (3, 3, 8))
        self.part = wp.to_torch(wp.array(ptr=self.wide.data_ptr() + 12, shape=(N, 2), strides=(32, 4), dtype=float))
        self.flat = torch.randn(N * 4, generator=generator)
        self.square = torch.randn(N, N, generator=generator)
        self.count = torch.zeros((), dtype=torch.int64)
        self.ids = torch.randperm(N, generator=generator)[:RESETS]
        self.start = {name: value.clone() for name, value in self.memory().items()}

    def memory(self) -> dict[str, torch.Tensor]:
        """The tensors, but for ``part``, which lies in another one."""
        return {k: v for k, v in vars(self).items() if isinstance(v, torch.Tensor) and k != "part"}

    def reset(self) -> None:
        for name, value in self.memory().items():
            value.copy_(self.start[name])


STATE = State()


@wp.kernel(enable_backward=False)
def halve(values: wp.array2d[float]):
    row, column = wp.tid()
    values[row, column] *= 0.5


def reads_another_row(s: State) -> Any:
    doubled = s.x * 2.0
    return doubled + doubled[0], doubled.sum()


def turns_rows(s: State) -> Any:
    s.x.copy_(s.x.flip(0))
    return s.x + 1.0


def writes_what_was_read_across(s: State) -> Any:
    other = s.y + s.x[3]
    s.x += 1.0
    return other


def overlapping_arrays(s: State) -> Any:
    s.wide *= 2.0
    s.part += 1.0  # the same memory by another storage
    return s.wide[:, 3:5] * s.part


def counts(s: State) -> Any:
    s.count += 1
    return s.x * s.count


def launches_warp(s: State) -> Any:
    s.x += s.y
    wp.launch(halve, (N, 3), [wp.from_torch(s.x)], device="cpu")
    return s.x - s.y


def draws(s: State) -> Any:
    torch.manual_seed(5)
    noise = torch.randn(N, 3)
    return s.x + 0.1 * noise, torch.rand_like(s.x) * 2.0 - 1.0


def logs(s: State) -> Any:
    progress = (s.x * s.y).sum(-1)
    mean = progress.mean()
    return mean, torch.where(progress > 0.0, progress, -1.0)


def unset(s: State) -> Any:
    made = torch.empty(N, 4)
    made[:, :3] = s.x
    made[:, 3] = 1.0
    return made * 2.0


def columns_as_rows(s: State) -> Any:
    turned = s.square.t()
    scaled = s.square * 2.0
    return scaled + scaled.t(), turned + 1.0


def flat_rows(s: State) -> Any:
    s.flat += 1.0
    return s.flat.view(N, 4) * s.x[:, :1], s.flat.view(4, N).sum(0)


def resets(s: State) -> Any:
    start = s.wide[s.ids]
    start[:, :3] += s.y[s.ids]
    s.x[s.ids] = start[:, :3]
    s.wide[s.ids, 6] = -1.0
    s.y[s.ids] = 0.0
    kept = s.x[s.ids] * 2.0
    return kept, s.x + s.y


def other_type(s: State) -> Any:
    s.x += 1.0
    return s.x.view(torch.int32) + 1


def temporaries(s: State) -> Any:
    total = s.x
    for k in range(5):
        total = (total * 1.5 + s.y).clamp(-2.0, 2.0 + k)
    return total[:, 0]


def copies_to_view(s: State) -> Any:
    return (s.wide.view(N, 2, 4).transpose(1, 2).reshape(N, 8) * 2.0).reshape(N, 4, 2) + 1.0


CASES: dict[str, tuple[Callable[[State], Any], int]] = {
    function.__name__: (function, count)
    for function, count in (
        (reads_another_row, 2), (turns_rows, 1), (writes_what_was_read_across, 2), (overlapping_arrays, 1),
        (counts, 1), (launches_warp, 2), (draws, 1), (logs, 2), (unset, 1), (columns_as_rows, 2), (flat_rows, 2),
        (resets, 3), (other_type, 2), (temporaries, 1), (copies_to_view, 1),
    )
}  # fmt: skip
"""Functions, each with the number of its chains."""


@pytest.fixture(scope="module")
def fused() -> dict[str, Fused]:
    functions = {name: lambda f=function: f(STATE) for name, (function, _) in CASES.items()}
    return run_fused(functions, (N, RESETS), STATE.reset, lambda: {k: v.clone() for k, v in STATE.memory().items()})


@pytest.mark.parametrize("name", CASES)
def test_results_and_memory_are_those_of_torch(fused, name):
    STATE.reset()
    expected, memory = CASES[name][0](STATE), STATE.memory()
    leaves = [r if isinstance(r, tuple) else (r,) for r in (fused[name].result, expected)]
    for one, two in zip(*leaves, strict=True):
        torch.testing.assert_close(one, two, rtol=0.0, atol=0.0)
    for key, value in memory.items():
        assert torch.equal(fused[name].left[key], value), key


def test_chains_break_only_where_they_must(fused):
    assert {name: len(run.launched.codes) for name, run in fused.items()} == {k: n for k, (_, n) in CASES.items()}


def test_only_what_is_read_later_is_written(fused):
    """Of ten operations on three columns the last tensor is written, as a view of it is returned, and no other."""
    (code,) = fused["temporaries"].traced.codes
    assert sum(line.startswith("*") for line in code.body.splitlines()) == 3, code.body


def test_long_chains_are_divided(monkeypatch):
    monkeypatch.setattr(chain, "MAX_STATEMENTS", 30)
    run = run_fused({"long": lambda: temporaries(STATE)}, N, STATE.reset)["long"]
    assert len(run.launched.codes) >= 2
    STATE.reset()
    assert torch.equal(run.result, temporaries(STATE))


def test_another_run_is_an_error():
    """A hook that does something else when it is recorded must not run with the kernels that there are."""
    x = torch.ones(N, 3)
    mode = FusingMode(torch.device("cpu"), (N,), launches=True)
    with pytest.raises(NotFusible, match="its operations are others than in the run before"), torch.no_grad(), mode:
        x.mul_(0.123456)
    assert torch.equal(x, torch.ones(N, 3))


def test_equal_chains_share_a_kernel(fused):
    digest = fused["temporaries"].traced.codes[0].digest
    kernel = chain_kernels._KERNELS[digest]
    again = run_fused({"again": lambda: temporaries(STATE)}, N, STATE.reset)
    assert chain_kernels._KERNELS[digest] is kernel
    assert again["again"].launched.operations > 0


@pytest.mark.slow
def test_code_for_gpus_compiles(tmp_path):
    functions = {name: lambda f=function: f(STATE) for name, (function, _) in CASES.items()}
    codes = gpu_codes(functions, (N, RESETS), STATE.reset)
    assert compile_for_gpu(codes, tmp_path).count(".entry") == len(codes)
