# SPDX-License-Identifier: Apache-2.0
"""Times of the convolutions of a network that sees pictures: torch's modules beside the forms for a GPU.

    python tools/benchmarks/convolution_forms.py [--samples 16384] [--size 64]

Each row is one minibatch of an update, forward and backward, as a CUDA graph, and a rollout's step of 4096 pictures.
The network is that of ``Stripe-Cartpole-Camera-Direct-v0``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import torch
import warp as wp
from rsl_rl.modules import CNN

from stripe_newton.rl.graphs.picture_layers import PictureForm, convolve
from stripe_newton.rl.graphs.program import Program

STEP = 4096


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
    parser.add_argument("--samples", type=int, default=16384)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--device", default="cuda:0" if torch.cuda.is_available() else "cpu")
    args = parser.parse_args()
    wp.init()
    device = torch.device(args.device)
    torch.set_float32_matmul_precision("high")
    cnn = CNN((args.size, args.size), 3, (32, 64, 64), (8, 4, 3), (4, 2, 1)).to(device)
    pictures = torch.rand(args.samples, 3, args.size, args.size, device=device)
    for parameter in cnn.parameters():
        parameter.grad = torch.zeros_like(parameter)
    weights = torch.randn(args.samples, cnn.output_dim, device=device)

    print("| form | bfloat16 | tuned | minibatch ms | step ms |\n|---|---|---|---:|---:|")
    for tuned in (False, True):
        torch.backends.cudnn.benchmark = tuned
        for bf16 in (False, True):
            for form in [None, *(PictureForm(blocks, last) for blocks in (False, True) for last in (False, True))]:

                def forward(rows: torch.Tensor, form: PictureForm | None = form, bf16: bool = bf16) -> torch.Tensor:
                    with torch.autocast(device.type, torch.bfloat16, bf16, cache_enabled=False):
                        return cnn(rows) if form is None else convolve(cnn, rows, form)

                def learn(forward: Callable[[torch.Tensor], torch.Tensor] = forward) -> None:
                    (forward(pictures).float() * weights).sum().backward()

                @torch.no_grad()
                def step(forward: Callable[[torch.Tensor], torch.Tensor] = forward) -> None:
                    forward(pictures[:STEP])

                name = "modules" if form is None else " ".join(n for n, value in form._asdict().items() if value)
                row = name or "elu in place", bf16, tuned, f"{timed(learn, device):.2f}", f"{timed(step, device):.2f}"
                print("| " + " | ".join(map(str, row)) + " |", flush=True)


if __name__ == "__main__":
    main()
