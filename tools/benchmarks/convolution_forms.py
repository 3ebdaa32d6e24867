# SPDX-License-Identifier: Apache-2.0
"""Times of the convolutions of a network that sees pictures: torch's modules beside the forms for a GPU.

    python tools/benchmarks/convolution_forms.py [--samples 4096] [--size 64]

Each row is one minibatch of an update, gathered from a rollout, forward and backward, as a CUDA graph, and a rollout's
step of 4096 pictures. ``gathered`` reads pictures from the rollout as blocks, as an update does. The network is that of
``Stripe-Cartpole-Camera-Direct-v0``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import torch
import warp as wp
from rsl_rl.modules import CNN

from stripe_newton.rl.graphs.picture_layers import PictureForm, convolve, convolve_rows
from stripe_newton.rl.graphs.program import Program

STEP = 4096
Network = Callable[[torch.Tensor], torch.Tensor]


def timed(function: Callable[[], object], device: torch.device) -> float:
    """Milliseconds of a call, the shortest of some."""
    program, times = Program(function, device), []
    for _ in range(6):  # the first is eager, the second records
        start = time.perf_counter()
        program.run()
        if device.type == "cuda":
            torch.cuda.synchronize()
        times.append(1e3 * (time.perf_counter() - start))
    return min(times[2:])


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=4096)
    parser.add_argument("--stored", type=int, default=32768)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--device", default="cuda:0" if torch.cuda.is_available() else "cpu")
    args = parser.parse_args()
    wp.init()
    device = torch.device(args.device)
    torch.set_float32_matmul_precision("high")
    cnn = CNN((args.size, args.size), 3, (32, 64, 64), (8, 4, 3), (4, 2, 1)).to(device)
    stored = torch.rand(args.stored, 3, args.size, args.size, device=device)
    rows = torch.randperm(args.stored, device=device)[: args.samples]
    for parameter in cnn.parameters():
        parameter.grad = torch.zeros_like(parameter)
    weights = torch.randn(args.samples, cnn.output_dim, device=device)

    def of_pictures(form: PictureForm | None) -> Network:
        return cnn if form is None else lambda pictures: convolve(cnn, pictures, form)

    forms = [None, *(PictureForm(blocks, last) for blocks in (False, True) for last in (False, True))]
    print("| form | bfloat16 | tuned | minibatch ms | step ms |\n|---|---|---|---:|---:|")
    for tuned in (False, True):
        torch.backends.cudnn.benchmark = tuned
        for bf16 in (False, True):

            def learn(output: Callable[[], torch.Tensor], bf16: bool = bf16) -> None:
                with torch.autocast(device.type, torch.bfloat16, bf16, cache_enabled=False):
                    result = output()
                (result.float() * weights).sum().backward()

            @torch.no_grad()
            def step(network: Network, bf16: bool = bf16) -> None:
                with torch.autocast(device.type, torch.bfloat16, bf16, cache_enabled=False):
                    network(stored[:STEP])

            for form in forms:
                network = of_pictures(form)
                name = "modules" if form is None else " ".join(n for n, value in form._asdict().items() if value)
                minibatch = partial(learn, lambda network=network: network(stored[rows]))
                print_row(
                    name or "elu in place",
                    bf16,
                    tuned,
                    *(timed(f, device) for f in (minibatch, partial(step, network))),
                )
            gathered = partial(convolve_rows, cnn, stored, rows, forms[-1], bf16)
            print_row("gathered blocks channels_last", bf16, tuned, timed(partial(learn, gathered), device))


def print_row(name: str, bf16: bool, tuned: bool, *times: float) -> None:
    """Print a row of the table."""
    print("| " + " | ".join([name, str(bf16), str(tuned), *(f"{value:.2f}" for value in times)]) + " |", flush=True)


if __name__ == "__main__":
    main()
