# SPDX-License-Identifier: Apache-2.0
"""Train the quadruped for the imported flat on a GPU, and film its walk: ``train_in_flat.py OUT``.

Options: ``--task NAME`` (the rough velocity task by default, which sees the stairs in its height scan), ``--ground``
``stairs`` (in the flat and on mounds of stairs beside it, the default), ``flat`` (in the flat alone) or ``own`` (on the
ground of the task, so that the flat is new to the policy), ``--num-envs N``, ``--iterations K``, ``--device D``. OUT
gets the run folder and the film. The script runs the commands that a user would type, prints them, and says how long
each took; ``walk_in_flat.py`` is what films.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "authoring"))

from author_flat import author_flat


def training(args: argparse.Namespace) -> list[str]:
    """The command that trains."""
    options = ["--max-iterations", args.iterations, "--log-dir", args.out / "logs", "--seed", 1, "--final-video", False]
    words = ["-m", "stripe_newton.cli", "train", args.task, "--num-envs", args.num_envs, *options]
    if args.ground != "own":
        words += ["--env.scene.scenery", author_flat(args.out / "flat.usda", stairs=args.ground == "stairs")]
        words += ["--env.scene.scenery-options.start.num-spots", 1024]
    return [str(word) for word in words]


def run_command(words: list[str], device: str | None) -> None:
    """Run a command of Python and say how long it took.

    Raises:
        SystemExit: with its exit code, if it fails.
    """
    words = [*words, *(["--device", device] if device else [])]
    print("python " + " ".join(words), flush=True)
    start = time.perf_counter()
    done = subprocess.run([sys.executable, *words], check=False)
    print(f"{time.perf_counter() - start:.0f} s", flush=True)
    if done.returncode:
        sys.exit(done.returncode)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--task", default="Stripe-Velocity-Rough-Quadruped-v0")
    parser.add_argument("--ground", choices=("stairs", "flat", "own"), default="stairs")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--iterations", type=int, default=1500)
    parser.add_argument("--device")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    args.out = args.out.resolve()
    run_command(training(args), args.device)
    run = max((args.out / "logs").glob("*/*/checkpoints"), key=lambda path: path.stat().st_mtime).parent
    run_command([str(Path(__file__).with_name("walk_in_flat.py")), str(run), str(args.out / "walk.mp4")], args.device)


if __name__ == "__main__":
    main()
