# SPDX-License-Identifier: Apache-2.0
"""Times of the layers of a network in an update: a library's products beside Triton's fused layers.

    python tools/benchmarks/layer_kernels.py [--samples 24576] [--widths 48 512 256 128 12]

Each is a graph of 20 calls. Differences of the two results are relative to the largest number. On the CPU only the
library's are timed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import torch
import warp as wp

from stripe_newton.rl.graphs.layer_kernels import LIBRARY, TRITON
from stripe_newton.rl.graphs.program import Program

CALLS = 20


def timed(function: Callable[[], torch.Tensor], device: torch.device) -> tuple[float, torch.Tensor]:
    """Microseconds of a call, the shortest of some, and its result."""
    found: list[torch.Tensor] = []

    def repeat() -> None:
        found.clear()
        for _ in range(CALLS):
            found[:] = [function()]

    program, times = Program(repeat, device), []
    for _ in range(8):  # the first is eager, the second records
        start = time.perf_counter()
        program.run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        times.append(1e6 * (time.perf_counter() - start) / CALLS)
    return min(times[2:]), found[0]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=24576)
    parser.add_argument("--widths", type=int, nargs="+", default=[48, 512, 256, 128, 12])
    parser.add_argument("--device", default="cuda:0")
    args = parser.parse_args()
    wp.init()
    m, device = args.samples, torch.device(args.device)
    ways = [LIBRARY, TRITON] if device.type == "cuda" else [LIBRARY]
    torch.set_float32_matmul_precision("high")

    print("| | layer | library us | Triton us | difference |\n|---|---|---:|---:|---:|")
    for kind in (torch.float32, torch.bfloat16):
        for k, n in zip(args.widths[:-1], args.widths[1:], strict=True):
            x, by_out, weight, bias = (
                torch.randn(*shape, device=device).to(kind) for shape in ((m, k), (m, n), (n, k), (n,))
            )
            x, weight, sums = torch.nn.functional.elu(x), weight / k**0.5, torch.zeros(m, k, device=device)
            parts = [(way, sums[: -(-m // way.rows)]) for way in ways]
            cases = {
                f"{k} to {n}": [lambda w=w: w.layer(x, weight, bias) for w in ways],  # noqa: B023
                f"gradient {n} to {k}": [lambda w=w, p=p: w.gradient(by_out, weight, x, p) for w, p in parts],  # noqa: B023
                f"weights {k} to {n}": [lambda: by_out.t() @ x],  # noqa: B023
            }
            for name, functions in cases.items():
                found = [timed(f, device) for f in functions]
                (first, one), (second, two) = found[0], found[-1]
                apart = float((one - two).abs().max() / one.abs().max())
                print(f"| {str(kind)[6:]} | {name} | {first:.1f} | {second:.1f} | {apart:.1e} |")


if __name__ == "__main__":
    main()
