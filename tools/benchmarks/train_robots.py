# SPDX-License-Identifier: Apache-2.0
"""Training of published robots: train a list of tasks one after the other, evaluate each, print one short table.

    python tools/benchmarks/train_robots.py OUT [TASK[:ITERATIONS][@NUM_ENVS] ...]
        [--episodes 1024] [--seeds 1] [--minutes M] [--motions FILE_OR_FOLDER ...]

Without tasks it is the list :data:`TASKS`. Each is trained, evaluated over ``--episodes`` and its run kept through the
command line, as a user would. A task whose robot or motions are not there has the reason in its row, and the next one
follows; so does one that fails. The table, ``OUT/results.md``, is written after each task: what is done is kept where
the time of the machine ends. ``--minutes`` begins no further task after so many minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import torch

from stripe_newton.rl import read_metrics

TASKS = (
    "Stripe-Velocity-Flat-Go2-v0:300",
    "Stripe-Velocity-Flat-Go1-v0:300",
    "Stripe-Velocity-Flat-AnymalC-v0:450",
    "Stripe-Velocity-Flat-G1-v0:1000",
    "Stripe-Reach-Panda-v0:500",
    "Stripe-Lift-Cube-Panda-v0:1500",
    "Stripe-Open-Cabinet-Panda-v0:400",
    "Stripe-Velocity-Rough-Go1-v0:1000",
    "Stripe-Velocity-Rough-Go2-v0:1000",
    "Stripe-Velocity-Rough-AnymalC-v0:1000",
    "Stripe-Velocity-Rough-G1-v0:2000",
    "Stripe-Repose-Cube-Allegro-Direct-v0:2000",
    "Stripe-Tracking-Flat-G1-v0:3000",
    "Stripe-Getup-Flat-G1-v0:1500",
    "Stripe-Cartpole-Camera-Direct-v0:300@1024",
    "Stripe-Lift-Cube-Panda-Camera-v0:2000@1024",
    "Stripe-Velocity-Rough-Quadruped-Depth-v0:300@1024",
)
"""What is trained where nothing is named: task and iterations, the shortest first."""
HEAD = "| task | device | envs | iterations | seed | samples/s | time | 90 % after | result |"
WORD = re.compile(r"([\w-]+)(?::(\d+))?(?:@(\d+))?")


@dataclass
class Job:
    """A training: the task, and what is not as the task has it."""

    task: str
    iterations: str | None
    num_envs: str | None
    seed: int

    @classmethod
    def of(cls, word: str, seed: int) -> Job:
        """The job of ``TASK[:ITERATIONS][@NUM_ENVS]``."""
        match = WORD.fullmatch(word)
        if match is None:
            raise SystemExit(f"'{word}': must be TASK, TASK:ITERATIONS or TASK:ITERATIONS@NUM_ENVS")
        return cls(*match.groups(), seed)


class CommandError(RuntimeError):
    """A command that failed; the message is its last line."""


def run(log: Path, *words: str) -> str:
    """Run a command of the project; its output goes to a file.

    Raises:
        CommandError: if it fails.
    """
    command = [sys.executable, "-m", "stripe_newton.cli", *words, "--import", "stripe_tasks"]
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    log.write_text(done.stdout)
    if done.returncode:
        raise CommandError((done.stdout.strip().splitlines() or ["no output"])[-1])
    return done.stdout


def motion_options(task: str, motions: list[str], whole: bool) -> list[str]:
    """Options of a tracking task: its motions, and for an evaluation whole motions from their first frames."""
    if "Tracking" not in task or not motions:
        return []
    options = ["--env.commands.motion.motion-file", *motions]
    if whole:
        options += ["--env.commands.motion.sampling-mode", "start", "--env.episode-length-s", "600"]
    return options


def teacher_options(job: Job, out: Path) -> list[str]:
    """Options of a task by depth: its teacher's run, the last one in ``out`` or else a new one."""
    if "-Depth-" not in job.task:
        return []
    task = job.task.replace("-Depth-", "-")
    logs = sorted(out.glob(f"{task}-{job.seed}-train.log"))
    found = re.findall(r"run folder: (.*)", logs[-1].read_text()) if logs else []
    folder = found[-1].strip() if found else str(train(Job(task, None, None, job.seed), out, [])[0])
    return ["--teacher", folder]


def train(job: Job, out: Path, motions: list[str]) -> tuple[Path, float]:
    """Train; returns the run folder and the seconds of the whole command, without those of a teacher."""
    name = f"{job.task}-{job.seed}"
    words = ["train", job.task, "--seed", str(job.seed), "--log-dir", str(out / "logs")]
    words += ["--max-iterations", job.iterations] if job.iterations else []
    words += ["--num-envs", job.num_envs] if job.num_envs else []
    words += teacher_options(job, out)
    start = time.perf_counter()
    text = run(out / f"{name}-train.log", *words, *motion_options(job.task, motions, whole=False))
    return Path(re.findall(r"run folder: (.*)", text)[-1].strip()), time.perf_counter() - start


def evaluate(job: Job, folder: Path, out: Path, episodes: int, motions: list[str]) -> str:
    """Evaluate; returns success, or else the return, share of falls, length and the task's metrics in a few words."""
    report = out / f"{job.task}-{job.seed}.json"
    words = ["eval", job.task, "--checkpoint", str(folder), "--episodes", str(episodes), "--json", str(report)]
    words += ["--num-envs", str(min(episodes, 1024))]
    run(out / f"{job.task}-{job.seed}-eval.log", *words, *motion_options(job.task, motions, whole=True))
    found = json.loads(report.read_text())
    parts = [f"success {100.0 * found['success_rate']:.1f} %"] if found.get("success_rate") is not None else []
    if "Tracking" in job.task:  # an episode goes on to the end of the motion unless the robot is far from it
        parts.append(f"tracked to the end {100.0 * (1.0 - found['terminated_rate']):.1f} %")
    elif not parts:
        parts.append(f"return {found['mean_return']:.4g}")
    parts.append(f"ended early {100.0 * found['terminated_rate']:.1f} %")
    parts.append(f"length {found['mean_length']:.0f} of {found['max_length']}")
    parts += [f"{name} {value:.3g}" for name, value in found["metrics"].items()]
    return ", ".join(parts)


def row(job: Job, out: Path, episodes: int, motions: list[str]) -> str:
    """Train and evaluate a task; its row of the table."""
    device = torch.cuda.get_device_name(0) if torch.cuda.is_available() else "CPU"
    cells = [f"`{job.task}`", device]
    try:
        folder, seconds = train(job, out, motions)
        curve = read_metrics(folder / "metrics.csv")
        elapsed = curve["elapsed_s"]
        returns = curve.get("Train/mean_reward", [math.nan] * len(elapsed))  # none where no episode has ended yet
        best = max((x for x in returns if not math.isnan(x)), default=math.nan)
        # A share of the way from the first return, as returns may be negative.
        first = next((x for x in returns if not math.isnan(x)), math.nan)
        near = (t for t, r in zip(elapsed, returns, strict=True) if r >= first + 0.9 * (best - first))
        speeds = sorted(x for x in curve.get("Perf/total_fps", []) if not math.isnan(x))
        speed = f"{speeds[len(speeds) // 2]:,.0f}" if speeds else ""
        result = evaluate(job, folder, out, episodes, motions)
        envs = job.num_envs or "4096"
        cells += [envs, str(len(returns)), str(job.seed), speed, f"{seconds:.0f} s", f"{next(near, math.nan):.0f} s"]
    except CommandError as error:
        cells += ["", "", str(job.seed), "", "", ""]
        result = str(error).replace("|", "/")
    return "| " + " | ".join([*cells, result]) + " |"


def main() -> None:
    """Train each task, and write the table after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("tasks", nargs="*", default=list(TASKS))
    parser.add_argument("--episodes", type=int, default=1024)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--motions", nargs="+", default=[])
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    jobs = [Job.of(word, seed) for seed in args.seeds for word in args.tasks]
    lines, begin = [HEAD, "|---|---|---:|---:|---:|---:|---:|---:|---|"], time.perf_counter()
    for job in jobs:
        if time.perf_counter() - begin > 60.0 * args.minutes:
            print(f"out of time before {job.task}, seed {job.seed}", flush=True)
            break
        lines.append(row(job, args.out, args.episodes, args.motions))
        (args.out / "results.md").write_text("\n".join(lines) + "\n")
        print(lines[-1], flush=True)
    print("\n".join(["", *lines]))


if __name__ == "__main__":
    main()
