# SPDX-License-Identifier: Apache-2.0
"""Times of the layers of a network in an update on a GPU: a library's products beside Triton's fused layers.

    python tools/benchmarks/layer_kernels.py [--samples 24576] [--widths 48 512 256 128 12]

Each is replayed as a graph of 20 calls on memory of its own. Differences are those of the two results, relative to the
largest number.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

from stripe_newton.rl.graphs.layer_kernels import LIBRARY, TRITON

CALLS = 20


def timed(function: Callable[[], object]) -> float:
    """Microseconds of a call, as part of a graph."""
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        function()
    side.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        kept = [function() for _ in range(CALLS)]
    times = []
    for _ in range(5):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        graph.replay()
        end.record()
        end.synchronize()
        times.append(1e3 * start.elapsed_time(end) / CALLS)
    del kept
    return min(times)


def difference(one: torch.Tensor, two: torch.Tensor) -> float:
    """Largest difference of two tensors, relative to the largest number."""
    return float((one.float() - two.float()).abs().max() / one.float().abs().max())


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=24576)
    parser.add_argument("--widths", type=int, nargs="+", default=[48, 512, 256, 128, 12])
    args = parser.parse_args()
    torch.set_float32_matmul_precision("high")
    m = args.samples
    print("| | layer | library us | Triton us | difference |\n|---|---|---:|---:|---:|")
    for kind in (torch.float32, torch.bfloat16):
        for k, n in zip(args.widths[:-1], args.widths[1:], strict=True):
            x, weight, bias = (torch.randn(*s, device="cuda").to(kind) for s in ((m, k), (n, k), (n,)))
            weight /= k**0.5
            by_out = torch.randn(m, n, device="cuda").to(kind)
            x = torch.nn.functional.elu(x)
            sums = torch.zeros(k, device="cuda")
            cases = {
                f"{k} to {n}": [lambda f=f: f.layer(x, weight, bias) for f in (LIBRARY, TRITON)],  # noqa: B023
                f"gradient {n} to {k}": [
                    lambda f=f: f.gradient(by_out, weight, x, sums)  # noqa: B023
                    for f in (LIBRARY, TRITON)
                ],
            }
            for name, functions in cases.items():
                apart = difference(*(f() for f in functions))
                times = " | ".join(f"{timed(f):.1f}" for f in functions)
                print(f"| {str(kind)[6:]} | {name} | {times} | {apart:.1e} |")
            print(f"| {str(kind)[6:]} | weights' gradient | {timed(lambda: by_out.t() @ x):.1f} | | |")  # noqa: B023
    a = torch.randn(m, 512, device="cuda", dtype=torch.bfloat16)
    out = torch.empty(512, 512, device="cuda")
    try:
        torch.mm(a.t(), a, out_dtype=torch.float32, out=out)
        print("mm with out_dtype:", difference(out, a.float().t() @ a.float()))
    except (RuntimeError, TypeError) as error:
        print("mm with out_dtype:", error)


if __name__ == "__main__":
    main()
