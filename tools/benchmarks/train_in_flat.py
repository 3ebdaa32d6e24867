# SPDX-License-Identifier: Apache-2.0
"""Train the quadruped in the imported flat on a GPU, and film it: ``python tools/benchmarks/train_in_flat.py OUT``.

Options: ``--task NAME`` (the flat velocity task by default; the rough one climbs the stairs by its height scan),
``--num-envs N``, ``--iterations K``, ``--device D``. OUT gets the flat, the run folder and the film. The script runs
the commands that a user would type, prints them, and says how long each took.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "authoring"))

from author_flat import author_flat


def commands(args: argparse.Namespace, flat: Path, run: Path | None) -> list[str]:
    """The command that trains, or with a run the one that films its policy."""
    if run is None:
        options = ["--max-iterations", args.iterations, "--log-dir", args.out / "logs", "--seed", 1]
        words = ["train", args.task, "--num-envs", args.num_envs, *options, "--final-video", False]
        words += ["--env.scene.scenery", flat]
    else:
        # From above the open living room, at rest: the robot starts in it and crosses the picture.
        view = {"origin-type": "world", "eye": (-6.2, -6.2, 7.6), "lookat": (-1.6, -0.2, 0.3), "fov": 42}
        words = ["play", args.task, "--checkpoint", run, "--viewer", "video", "--num-envs", 1, "--steps", 1000]
        words += ["--env.commands.base-velocity.ranges.lin-vel-x", 0.6, 1.0]
        words += ["--env.scene.scenery-options.start.upper", 0.8, 2.2, 1.5]
        for name, value in view.items():
            words += [f"--env.viewer.{name}", *(value if isinstance(value, tuple) else (value,))]
    if args.device is not None:
        words += ["--device", args.device]
    return [str(word) for word in words]


def run_command(words: list[str]) -> None:
    """Run ``stripe-newton`` and say how long it took.

    Raises:
        SystemExit: with its exit code, if it fails.
    """
    print("stripe-newton " + " ".join(words), flush=True)
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "stripe_newton.cli", *words], check=False)
    print(f"{time.perf_counter() - start:.0f} s", flush=True)
    if done.returncode:
        sys.exit(done.returncode)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--task", default="Stripe-Velocity-Flat-Quadruped-v0")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--device")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    args.out = args.out.resolve()
    flat = author_flat(args.out / "flat.usda")
    run_command(commands(args, flat, None))
    run = max((args.out / "logs").glob("*/*/checkpoints"), key=lambda path: path.stat().st_mtime).parent
    run_command(commands(args, flat, run))
    print(f"film: {next(iter(sorted((run / 'videos').glob('play_*.mp4'))))}")


if __name__ == "__main__":
    main()
