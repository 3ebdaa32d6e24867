# SPDX-License-Identifier: Apache-2.0
"""Call counts of a step: launches, copies and synchronisations, counted from a trace."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_newton.envs.call_counts import REGION, calls_in_trace, count_calls, warp_calls


def call(category: str, name: str, start: float, dur: float = 1.0, tid: int = 1, **args) -> dict:
    return {"ph": "X", "cat": category, "name": name, "ts": start, "dur": dur, "tid": tid, "args": args}


def test_calls_are_counted_by_kind_within_the_steps():
    events = [
        {"ph": "M", "name": "process_name"},
        call("user_annotation", REGION, 0.0, 100.0),
        call("user_annotation", REGION, 200.0, 100.0),
        call("gpu_user_annotation", REGION, 100.0, 100.0),
        call("user_annotation", "something else", 100.0, 100.0),
        call("cuda_runtime", "cudaGraphLaunch", 1.0, 5.0, correlation=1),
        call("cuda_driver", "cuGraphLaunch", 2.0, 1.0),  # the same call, seen from within
        call("cuda_driver", "cuGraphLaunch_ptsz", 2.0, 1.0, tid=2),  # another thread's own
        call("cuda_runtime", "cudaLaunchKernel", 10.0, correlation=2),
        call("cuda_driver", "cuLaunchKernelEx", 20.0, correlation=3),
        call("cuda_runtime", "cudaLaunchKernel", 150.0, correlation=4),  # between the steps
        call("cuda_runtime", "cudaMemcpyAsync", 210.0, correlation=5),
        call("cuda_runtime", "cudaMemsetAsync_v3020", 211.0),
        call("cuda_runtime", "cudaStreamSynchronize", 212.0),
        call("cuda_driver", "cuMemcpyDtoH_v2", 220.0),
        call("cuda_runtime", "cudaStreamIsCapturing", 221.0),
        call("cpu_op", "cudaLaunchKernel", 222.0),
        *(call("kernel", f"k{i}", 400.0 + i, correlation=1) for i in range(7)),
        call("kernel", "k", 420.0, correlation=2),
        call("kernel", "k", 421.0, correlation=4),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pageable)", 430.0, correlation=5),
    ]
    counts = calls_in_trace({"traceEvents": events})
    assert dict(counts) == {
        "graph_launches": 2,
        "kernel_launches": 2,
        "copies": 2,
        "host_syncs": 2,
        "kernels": 8,
    }


def test_copies_to_the_host_are_waits_where_no_other_is_seen():
    events = [
        call("user_annotation", REGION, 0.0, 100.0),
        call("cuda_runtime", "cudaMemcpyAsync", 1.0, correlation=1),
        call("cuda_runtime", "cudaMemcpyAsync", 3.0, correlation=2),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pageable)", 2.0, correlation=1),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pinned)", 4.0, correlation=2),
    ]
    assert calls_in_trace({"traceEvents": events})["host_syncs"] == 1


def test_what_the_profiler_does_not_see_of_warp_is_added():
    events = [
        call("user_annotation", REGION, 0.0, 100.0),
        call("cuda_runtime", "cudaStreamSynchronize", 1.0),  # by torch
        call("cuda_runtime", "cudaGraphLaunch", 3.0),  # by Warp
    ]
    counts = calls_in_trace({"traceEvents": events}, {"host_syncs": 3, "graph_launches": 1, "kernel_launches": 2})
    assert (counts["host_syncs"], counts["graph_launches"], counts["kernel_launches"]) == (4, 1, 2)


def test_warps_functions_are_its_own_again():
    wp.init()
    core = wp._src.context.runtime.core
    before = core.wp_cuda_stream_synchronize
    with warp_calls():
        assert core.wp_cuda_stream_synchronize is not before
    assert core.wp_cuda_stream_synchronize is before


@pytest.mark.gpu
def test_each_call_is_counted_once_on_a_gpu():
    source = torch.rand(1024, device="cuda:0")
    array, other = wp.from_torch(source), wp.zeros(1024, dtype=float, device="cuda:0")
    with wp.ScopedCapture("cuda:0") as capture:
        for _ in range(5):
            other.fill_(1.0)
            wp.copy(other, array)
            wp.launch(_double, dim=1024, inputs=[other], device="cuda:0")

    def step(index: int) -> None:
        wp.capture_launch(capture.graph)
        wp.launch(_double, dim=1024, inputs=[other], device="cuda:0")
        source.mul_(2.0)
        torch.add(source, 1.0, out=source)
        wp.synchronize_stream("cuda:0")
        source.sum().item()

    step(0)
    counts = count_calls(step, 10)
    assert counts["graph_launches"] == 1.0
    assert counts["kernel_launches"] == 4.0
    assert counts["host_syncs"] == 2.0
    assert counts["kernels"] >= 4.0 + 5.0


@wp.kernel(enable_backward=False)
def _double(values: wp.array[float]):
    i = wp.tid()
    values[i] = 2.0 * values[i]
