# SPDX-License-Identifier: Apache-2.0
"""Call counts: graph launches, kernel launches, copies and host synchronisations of a step."""

from __future__ import annotations

import bisect
import contextlib
import json
import re
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

import torch
import warp as wp

__all__ = ["calls_in_trace", "count_calls", "warp_calls", "warp_waits"]

REGION = "stripe_newton.step"
"""Annotation around each step in a trace."""

_KINDS: dict[str, set[str]] = {
    "graph_launches": {"cudaGraphLaunch", "cuGraphLaunch"},
    "kernel_launches": {
        *("cudaLaunchKernel", "cudaLaunchKernelExC", "cudaLaunchCooperativeKernel"),
        *("cuLaunchKernel", "cuLaunchKernelEx", "cuLaunchCooperativeKernel"),
    },
    "copies": {
        *("cudaMemcpyAsync", "cudaMemcpy2DAsync", "cudaMemcpy3DAsync", "cudaMemsetAsync", "cudaMemset2DAsync"),
        *("cuMemcpyAsync", "cuMemcpyDtoDAsync", "cuMemcpyHtoDAsync", "cuMemcpyDtoHAsync", "cuMemcpy2DAsync"),
        *("cuMemsetD8Async", "cuMemsetD32Async", "cuMemsetD2D8Async"),
    },
    "host_syncs": {
        *("cudaDeviceSynchronize", "cudaStreamSynchronize", "cudaEventSynchronize"),
        *("cuCtxSynchronize", "cuStreamSynchronize", "cuEventSynchronize"),
        *("cudaMemcpy", "cudaMemcpy2D", "cuMemcpy", "cuMemcpyDtoH", "cuMemcpyHtoD"),
    },
}
Event = dict[str, Any]
"""An event of a trace in Chrome's format."""
_VERSION = re.compile(r"(_v\d+|_ptsz|_ptds)+$")
_WARP = {
    "wp_cuda_graph_launch": "graph_launches",
    "wp_cuda_launch_kernel": "kernel_launches",
    "wp_cuda_context_synchronize": "host_syncs",
    "wp_cuda_stream_synchronize": "host_syncs",
    "wp_cuda_event_synchronize": "host_syncs",
}


def count_calls(step: Callable[[int], object], steps: int) -> dict[str, float]:
    """CUDA calls a step, counted by torch's profiler and, for what it does not see of Warp, in Warp itself.

    Args:
        step: Takes step ``index``.
        steps: Number of steps.

    Returns:
        ``graph_launches``, ``kernel_launches`` (outside graphs), ``copies`` (and fills, outside graphs), ``host_syncs``
        and ``kernels`` (run by the GPU, those of graphs included), each a step.
    """
    from torch.profiler import ProfilerActivity, profile, record_function

    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiler:
        with warp_calls() as in_warp:
            for index in range(steps):
                with record_function(REGION):
                    step(index)
        torch.cuda.synchronize()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.json"
        profiler.export_chrome_trace(str(path))
        traced = calls_in_trace(json.loads(path.read_text(encoding="utf-8", errors="replace")), in_warp)
    return {kind: count / steps for kind, count in traced.items()}


def calls_in_trace(
    trace: dict[str, list[Event]], in_warp: dict[str, int] | None = None, region: str = REGION
) -> Counter[str]:
    """CUDA calls of a Chrome trace within the host's annotations called ``region``, by kind.

    The runtime makes its calls through the driver, so a driver call within a runtime call is counted once. A copy to
    pageable memory waits for the device; such copies count as synchronisations where they outnumber those in the trace.

    Args:
        trace: As ``torch.profiler`` exports it.
        in_warp: Calls that Warp made, by kind. Warp calls the driver, which a profiler may not show, so the larger of
            the two numbers counts.
        region: Name of the annotations.
    """
    events = [e for e in trace["traceEvents"] if e.get("ph") == "X"]
    inside = _within_annotations(events, region)
    runtime = [e for e in inside if _is(e, "cuda_runtime")]
    driver = [e for e in inside if _is(e, "cuda_driver")]
    by_runtime, by_driver = _kinds_of(runtime), _kinds_of(_outermost(driver, runtime))
    launched = {_correlation(e) for e in (*runtime, *driver)} - {None}
    on_gpu = [e for e in events if _correlation(e) in launched]
    total: Counter[str] = Counter()
    for kind in _KINDS:
        of_warp = (in_warp or {}).get(kind, 0)
        if kind == "graph_launches":  # Warp launches them through the runtime
            total[kind] = max(by_runtime[kind] + by_driver[kind], of_warp)
        else:
            total[kind] = by_runtime[kind] + max(by_driver[kind], of_warp)
    pageable = sum(_is(e, "gpu_memcpy") and "DtoH" in e["name"] and "Pageable" in e["name"] for e in on_gpu)
    total["host_syncs"] = max(total["host_syncs"], pageable)
    total["kernels"] = sum(_is(e, "kernel") for e in on_gpu)
    return total


def _within_annotations(events: list[Event], name: str) -> list[Event]:
    """Events that start within the host's annotations of a name."""
    spans = sorted((e["ts"], e["ts"] + e["dur"]) for e in events if _is(e, "user_annotation") and e["name"] == name)
    starts = [start for start, _ in spans]
    before = ((e, bisect.bisect_right(starts, e["ts"]) - 1) for e in events)
    return [e for e, index in before if index >= 0 and e["ts"] < spans[index][1]]


def _kinds_of(calls: list[Event]) -> Counter[str]:
    """Number of CUDA calls by kind."""
    counts: Counter[str] = Counter()
    for call in calls:
        base = _VERSION.sub("", call["name"])
        counts.update(kind for kind, names in _KINDS.items() if base in names)
    return counts


@contextlib.contextmanager
def warp_calls() -> Iterator[Counter[str]]:
    """Count the launches and synchronisations that Warp's Python side asks its library for, by kind, until closed."""
    counts: Counter[str] = Counter()

    def count(kind: str) -> None:
        counts[kind] += 1

    with _on_warp_calls(_WARP, count), _on_waits_for_resets(lambda: count("host_syncs")):
        yield counts


@contextlib.contextmanager
def _on_waits_for_resets(note: Callable[[], None]) -> Iterator[None]:
    """Call a function where the host waits for a number of resets.

    It looks at memory that the device writes, which is no call of any library.
    """
    module = sys.modules.get("stripe_newton.sim.reset_mask")  # another package, that is compared, has none
    if module is None:
        yield
        return
    wait = module.ResetMask.wait

    def noted(mask: object) -> None:
        note()
        wait(mask)

    with mock.patch.object(module.ResetMask, "wait", noted):
        yield


@contextlib.contextmanager
def warp_waits(error: Exception) -> Iterator[None]:
    """Raise an error where Warp's Python side asks its library to wait for the device, until closed."""

    def refuse(kind: str) -> None:
        raise error

    with _on_warp_calls({name: kind for name, kind in _WARP.items() if kind == "host_syncs"}, refuse):
        yield


@contextlib.contextmanager
def _on_warp_calls(kinds: Mapping[str, str], note: Callable[[str], None]) -> Iterator[None]:
    """Call a function with the kind of each of some calls to Warp's library before it is made."""
    # Warp has no hook for this. Its Python side looks each function up in this object at every call, so replacing the
    # attribute catches all of them.
    core = wp._src.context.runtime.core

    def noted(function: Callable[..., object], kind: str) -> Callable[..., object]:
        def call(*args: object) -> object:
            note(kind)
            return function(*args)

        return call

    originals = {name: getattr(core, name) for name in kinds}
    try:
        for name, function in originals.items():
            setattr(core, name, noted(function, kinds[name]))
        yield
    finally:
        for name, function in originals.items():
            setattr(core, name, function)


def _is(event: Event, category: str) -> bool:
    return event.get("cat") == category


def _correlation(event: Event) -> object:
    return event.get("args", {}).get("correlation")


def _outermost(inner: list[Event], outer: list[Event]) -> list[Event]:
    """The events of ``inner`` that do not lie within an event of ``outer`` on the same thread."""
    spans: dict[object, list[tuple[float, float]]] = defaultdict(list)
    for event in outer:
        spans[event.get("tid")].append((event["ts"], event["ts"] + event["dur"]))
    for times in spans.values():
        times.sort()
    found = []
    for event in inner:
        times = spans[event.get("tid")]
        index = bisect.bisect_right(times, (event["ts"], float("inf"))) - 1
        if index < 0 or event["ts"] + event["dur"] > times[index][1]:
            found.append(event)
    return found
