# SPDX-License-Identifier: Apache-2.0
"""Solver curves: trainings of one task with the fused solver and with MuJoCo Warp, compared over seeds.

    python tools/benchmarks/solver_curves.py OUT [--task TASK] [--seeds 5] [--iterations 200] [--jobs 10]
    python tools/benchmarks/solver_curves.py OUT --task Stripe-Ant-v0
    python tools/benchmarks/solver_curves.py OUT --no-train                 # evaluate and show the runs in OUT
    python tools/benchmarks/solver_curves.py OUT --no-train --no-evaluate   # only table and picture
    python tools/benchmarks/solver_curves.py OUT --task Stripe-Cartpole-v0 --device cpu --seeds 2 --iterations 4
        --num-envs 32 --episodes 8 --jobs 1                                 # tries it out

Each training runs through the command line, with ``fused`` of the solver set to True or False and the same seeds for
both. Several share a GPU, so only what is counted in samples is compared. A run of OUT that has all iterations is not
trained again. Then the policy of each run acts without exploration for one episode in each of ``--episodes``
environments, on both solvers: does a policy work as well on the solver that it was not trained on?

``OUT/curves.png`` shows mean and standard deviation over the seeds, ``OUT/results.md`` the tables: the return at the
end (mean of the last tenth of the iterations) and over the whole training, both with the p-value of an exact
permutation test, and the returns of the evaluation. ``OUT/results.json`` has the numbers of each run, ``OUT/logs`` what
the commands printed. A training that fails is named, and the others are compared. Other options go to
``stripe-newton train``.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, stdev
from typing import IO, Any

import numpy as np

from stripe_newton.cli.tasks import load_cfg
from stripe_newton.rl import RunFolder, find_checkpoint, read_metrics

Entry = dict[str, Any]
"""Results of a run, as they are written to JSON."""

TASK = "Stripe-Velocity-Flat-Quadruped-v0"
SOLVERS = {"fused": "one kernel", "mujoco_warp": "MuJoCo Warp"}
METRIC = "Train/mean_reward"
EVAL_SEED = 1000
"""Seed of the evaluations, which no training has."""


@dataclasses.dataclass
class Run:
    """Training of a seed with a solver."""

    solver: str
    seed: int
    folder: Path
    """Folder of its run folders."""

    @property
    def name(self) -> str:
        """Name of its folder and its log."""
        return f"{self.solver}_{self.seed}"

    @property
    def path(self) -> Path | None:
        """Run folder with the most iterations; None if there is none."""
        files = sorted(self.folder.glob("*/*/metrics.csv"))
        return max(files, key=lambda file: len(self.returns(file))).parent if files else None

    @staticmethod
    def returns(file: Path) -> list[float]:
        """Mean returns of the training by iteration."""
        return read_metrics(file).get(METRIC, [])

    def is_complete(self, iterations: int | None) -> bool:
        """Whether it has a checkpoint, and all iterations where their number is given."""
        path = self.path
        if path is None or not any(path.glob("checkpoints/model_*.pt")):
            return False
        return iterations is None or len(self.returns(path / "metrics.csv")) >= iterations


# -- processes


def run_jobs(commands: dict[str, list[str]], logs: Path, jobs: int, seconds: float) -> dict[str, str]:
    """Run commands, some at a time, each with a log file.

    Args:
        commands: Commands by name.
        logs: Folder of the logs.
        jobs: Commands at a time.
        seconds: Time after which a command is ended.

    Returns:
        Problems by name; empty text for a command that succeeded.
    """
    logs.mkdir(parents=True, exist_ok=True)
    variables = {"OMP_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // jobs)), **os.environ}
    waiting, found, count = list(commands), dict[str, str](), len(commands)
    running: dict[str, tuple[subprocess.Popen, IO[str], float]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                name = waiting.pop(0)
                log = (logs / f"{name}.log").open("w", encoding="utf-8")
                process = subprocess.Popen(commands[name], stdout=log, stderr=subprocess.STDOUT, env=variables)
                running[name] = process, log, time.perf_counter()
            for name, (process, log, start) in list(running.items()):
                took = time.perf_counter() - start
                if process.poll() is None and took < seconds:
                    continue
                late = process.poll() is None
                process.kill()
                process.wait()
                log.close()
                del running[name]
                found[name] = f"took longer than {seconds:.0f} s" if late else _problem(process, logs / f"{name}.log")
                print(f"{len(found)} of {count}: {name}, {took:.0f} s {found[name]}", flush=True)
            time.sleep(0.2)
    finally:
        for process, log, _ in running.values():
            process.kill()
            log.close()
    return found


def _problem(process: subprocess.Popen, log: Path) -> str:
    """Why a process failed; empty if it did not."""
    if not process.returncode:
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or [""]
    return f"failed with status {process.returncode}: {lines[-1]} (see {log})"


def train(runs: Sequence[Run], args: argparse.Namespace, rest: list[str]) -> None:
    """Train the runs that are not complete."""
    commands = {}
    for run in runs:
        if run.is_complete(args.iterations):
            print(f"{run.name}: is there already", flush=True)
            continue
        command = [sys.executable, "-m", "stripe_newton.cli", "train", args.task, "--import", "stripe_tasks"]
        command += ["--log-dir", str(run.folder), "--seed", str(run.seed), "--final-video", "False"]
        command += ["--env.sim.solver.fused", str(run.solver == "fused")]
        command += ["--max-iterations", str(args.iterations)]
        for name in ("num_envs", "device"):
            value = getattr(args, name)
            command += [] if value is None else [f"--{name.replace('_', '-')}", str(value)]
        commands[run.name] = [*command, *rest]
    print(f"training {len(commands)} runs of {args.task}, {args.jobs} at a time", flush=True)
    run_jobs(commands, args.out / "logs", args.jobs, args.job_seconds)


# -- evaluation


def evaluate(runs: Sequence[Run], args: argparse.Namespace) -> None:
    """Evaluate the policies of all runs on each solver, in a process for each solver."""
    commands, folder = {}, args.out / "evaluation"
    folder.mkdir(exist_ok=True)
    policies = {run.name: str(run.path) for run in runs if run.is_complete(None)}
    for solver in SOLVERS:
        request = folder / f"{solver}.request"
        (folder / f"{solver}.json").unlink(missing_ok=True)
        values = {"task": args.task, "solver": solver, "policies": policies, "device": args.device}
        request.write_text(json.dumps({**values, "episodes": args.episodes}), encoding="utf-8")
        commands[f"evaluate_on_{solver}"] = [sys.executable, str(Path(__file__).resolve()), "--request", str(request)]
    print(f"evaluating {len(policies)} policies on both solvers", flush=True)
    if policies:
        run_jobs(commands, args.out / "logs", min(args.jobs, 2), args.job_seconds)


def evaluate_on(request_file: Path) -> None:
    """Evaluate policies on one solver: an environment for all of them, reset with the same seed for each."""
    import stripe_tasks  # noqa: F401  (registers the tasks)
    from stripe_newton.cli.device import set_device, set_seeds
    from stripe_newton.cli.env_and_policy import build
    from stripe_newton.cli.run_configs import load_configs, use_one_minibatch
    from stripe_newton.rl import evaluate as measure
    from stripe_newton.rl.runs.training_state import restore_normalization

    request = json.loads(request_file.read_text(encoding="utf-8"))
    checkpoints = {name: find_checkpoint(path) for name, path in request["policies"].items()}
    first = next(iter(checkpoints.values()))
    configs = load_configs(request["task"], RunFolder.of_checkpoint(first))
    configs.env.sim.solver.fused = request["solver"] == "fused"
    configs.env.scene.num_envs, configs.env.seed = request["episodes"], EVAL_SEED
    set_device(configs.env, request["device"])
    use_one_minibatch(configs.need_agent())
    set_seeds(EVAL_SEED)
    runner = build(request["task"], configs)
    print(f"physics: {runner.env.unwrapped.sim.describe_solver()}", flush=True)
    found = {}
    for name, checkpoint in checkpoints.items():
        runner.load(checkpoint, load_cfg=runner.parts_to_act)
        restore_normalization(runner.env.unwrapped, checkpoint)
        set_seeds(EVAL_SEED)
        policy = runner.get_inference_policy(runner.device)
        found[name] = measure(runner.env, policy, request["episodes"], task=request["task"], seed=EVAL_SEED).to_dict()
        print(f"{name}: {found[name]}", flush=True)
        request_file.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


# -- results


def collect(runs: Sequence[Run], out: Path) -> list[Entry]:
    """Results of all runs that have any."""
    evaluations = {}
    for solver in SOLVERS:
        path = out / "evaluation" / f"{solver}.json"
        evaluations[solver] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    entries = []
    for run in runs:
        if run.path is None:
            continue
        columns = read_metrics(run.path / "metrics.csv")
        returns = columns.get(METRIC, [])
        if not any(map(math.isfinite, returns)):
            continue
        last = [r for r in returns[-max(1, len(returns) // 10) :] if math.isfinite(r)]
        entries.append(
            {
                "solver": run.solver,
                "seed": run.seed,
                "iterations": len(returns),
                "samples": columns["total_steps"],
                "returns": returns,
                "at_end": fmean(last) if last else math.nan,
                "over_training": fmean(filter(math.isfinite, returns)),
                "elapsed_s": columns["elapsed_s"][-1],
                "evaluation": {solver: found[run.name] for solver, found in evaluations.items() if run.name in found},
            }
        )
    return entries


def p_value(a: Sequence[float], b: Sequence[float]) -> float:
    """Exact permutation test: share of all splits of the values whose means differ at least as much; two-sided."""
    values, total = [*a, *b], sum(a) + sum(b)
    if not a or not b:
        return math.nan

    def difference(part: float) -> float:
        return abs(part / len(a) - (total - part) / len(b))

    least = difference(sum(a)) * (1.0 - 1e-9)
    splits = [difference(sum(part)) >= least for part in itertools.combinations(values, len(a))]
    return sum(splits) / len(splits)


def spread(values: Sequence[float], digits: int = 2) -> str:
    """Mean and standard deviation as text."""
    if not values:
        return "-"
    return f"{fmean(values):.{digits}f} ± {stdev(values) if len(values) > 1 else math.nan:.{digits}f}"


def page(task: str, entries: list[Entry], failed: list[str]) -> str:
    """Both tables in Markdown."""
    lines = [f"{task}: mean ± standard deviation over the seeds", ""]
    lines += ["| trained on | seeds | samples each | return at the end | return over the training |"]
    lines += ["|---|---:|---:|---:|---:|"]
    by = {solver: [e for e in entries if e["solver"] == solver] for solver in SOLVERS}
    for solver, mine in by.items():
        if mine:
            samples = f"{min(e['samples'][-1] for e in mine):,.0f}"
            cells = [spread([e[name] for e in mine]) for name in ("at_end", "over_training")]
            lines.append(f"| {SOLVERS[solver]} | {len(mine)} | {samples} | {' | '.join(cells)} |")
    if all(by.values()):
        tests = [p_value(*([e[name] for e in mine] for mine in by.values())) for name in ("at_end", "over_training")]
        lines.append(f"| p-value | | | {tests[0]:.2f} | {tests[1]:.2f} |")
    if any(e["evaluation"] for e in entries):
        episodes = next(r["episodes"] for e in entries for r in e["evaluation"].values())
        lines += ["", f"Return of the policies in {episodes} episodes, and share of episodes that ended early:", ""]
        lines += [
            "| trained on | " + " | ".join(f"run on {name}" for name in SOLVERS.values()) + " |",
            "|---|---:|---:|",
        ]
        for solver, mine in by.items():
            found = [[e["evaluation"][on] for e in mine if on in e["evaluation"]] for on in SOLVERS]
            lines.append(f"| {SOLVERS[solver]} | " + " | ".join(map(evaluated, found)) + " |")
    lines += ["", f"Without a result: {', '.join(failed)}"] if failed else []
    return "\n".join(lines) + "\n"


def evaluated(results: list[Entry]) -> str:
    """Returns and early ends of the evaluations of several policies as text."""
    if not results:
        return "-"
    ended = 100.0 * fmean(r["terminated_rate"] for r in results)
    return f"{spread([r['mean_return'] for r in results])}, {ended:.1f} %"


def plot(task: str, entries: list[Entry], path: Path) -> None:
    """Draw the mean and the standard deviation of the returns of both solvers over samples, and each run thinly."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for solver, color in (("mujoco_warp", "C1"), ("fused", "C0")):
        mine = [e for e in entries if e["solver"] == solver]
        if not mine:
            continue
        count = min(e["iterations"] for e in mine)
        samples, returns = mine[0]["samples"][:count], np.array([e["returns"][:count] for e in mine])
        known = np.isfinite(returns).all(axis=0)
        samples, returns = np.array(samples)[known], returns[:, known]
        for values in returns:
            axes.plot(samples, values, color=color, linewidth=0.5, alpha=0.35)
        mean, std = returns.mean(axis=0), returns.std(axis=0, ddof=1 if len(returns) > 1 else 0)
        axes.plot(samples, mean, color=color, linewidth=1.8, label=f"{SOLVERS[solver]}, {len(mine)} seeds")
        axes.fill_between(samples, mean - std, mean + std, color=color, alpha=0.2, linewidth=0.0)
    axes.set(xlabel="samples", ylabel="mean return of the training", title=task)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="lower right")
    figure.savefig(path, dpi=130)


def show(task: str, runs: Sequence[Run], out: Path) -> str:
    """Write numbers, table and picture; return the table."""
    entries = collect(runs, out)
    (out / "results.json").write_text(json.dumps({"task": task, "runs": entries}, indent=1) + "\n", encoding="utf-8")
    known = {(e["solver"], e["seed"]) for e in entries}
    text = page(task, entries, [run.name for run in runs if (run.solver, run.seed) not in known])
    (out / "results.md").write_text(text, encoding="utf-8")
    if entries:
        plot(task, entries, out / "curves.png")
    return text


def parse(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """Parse the command line; return also the options for the trainings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", nargs="?", help="folder of the runs and results")
    parser.add_argument("--task", default=TASK)
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds: 1, 2, ...")
    parser.add_argument("--iterations", type=int, help="iterations of a training; by default the task's")
    parser.add_argument("--num-envs", type=int, help="environments of a training; by default the task's")
    parser.add_argument("--episodes", type=int, default=256, help="environments of an evaluation, an episode in each")
    parser.add_argument("--jobs", type=int, default=10, help="trainings at a time")
    parser.add_argument("--job-seconds", type=float, default=1500.0, help="most time of a training or an evaluation")
    parser.add_argument("--device", help="cpu or cuda:N; by default the first GPU where there is one")
    parser.add_argument("--train", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--evaluate", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--request", type=Path, help=argparse.SUPPRESS)  # evaluate on one solver, in this process
    args, rest = parser.parse_known_args(arguments)
    if args.out is None and args.request is None:
        parser.error("OUT: name the folder of the results")
    for name in ("seeds", "jobs", "episodes"):
        if getattr(args, name) < 1:
            parser.error(f"--{name}: is {getattr(args, name)}, must be 1 or more")
    return args, rest


def main(arguments: list[str]) -> None:
    """Train, evaluate and show."""
    args, rest = parse(arguments)
    if args.request:
        evaluate_on(args.request)
        return
    args.out.mkdir(parents=True, exist_ok=True)
    # The solvers take turns, so that a run that is cut off has seeds of both.
    pairs = itertools.product(range(1, args.seeds + 1), SOLVERS)
    runs = [Run(solver, seed, args.out / "runs" / f"{solver}_{seed}") for seed, solver in pairs]
    if args.train:
        args.iterations = args.iterations or load_cfg(args.task, "agent").max_iterations
        train(runs, args, rest)
        print(show(args.task, runs, args.out), flush=True)
    if args.evaluate:
        evaluate(runs, args)
    print(show(args.task, runs, args.out))


if __name__ == "__main__":
    main(sys.argv[1:])
