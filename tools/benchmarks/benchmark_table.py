# SPDX-License-Identifier: Apache-2.0
"""Benchmark table: tasks, cost against the number of environments, gain of fusion, start-up.

    python tools/benchmarks/benchmark_table.py OUT
    python tools/benchmarks/benchmark_table.py OUT --parts tasks scaling --num-envs 4096 --budget 500
    python tools/benchmarks/benchmark_table.py OUT --parts            # only tables and pictures of the results in OUT

Parts: ``tasks`` (each at ``--num-envs``), ``scaling`` (``--scaling-tasks`` at each of ``--sizes``), ``fusion`` (the
terms of a task in one kernel against a kernel for each term), ``start`` (a process with an empty kernel cache, and a
second one). Every measurement is written to ``OUT/PART.json`` when it is done. A failure is noted there, and the other
measurements go on.
``OUT/benchmarks.md`` has the tables, ``OUT/scaling.png`` the curves.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import stripe_tasks  # noqa: F401  (registers the tasks)

KINDS = ("v0", "Direct-Warp-v0", "Direct-v0")
TASKS = [f"Stripe-{robot}-{kind}" for robot in ("Cartpole", "Ant", "Humanoid") for kind in KINDS]
WALKS = [f"Stripe-Velocity-{kind}-v0" for kind in ("Flat-Quadruped", "Rough-Quadruped", "Flat-Humanoid")]
TASKS += [*WALKS, "Stripe-Velocity-Flat-Quadruped-Direct-Warp-v0"]
SCALING_TASKS = ["Stripe-Cartpole-v0", "Stripe-Ant-v0"]
SIZES = [4**k for k in range(9)]
FUSION_SIZES = [256, 4096, 16384]
PARTS = ("tasks", "scaling", "fusion", "start")

Entry = dict[str, Any]
"""Measurement of one task at one number of environments, as it is written to JSON."""
Measurement = Callable[[str, int, argparse.Namespace], Entry]


# -- measuring


def measure(task: str, num_envs: int, args: argparse.Namespace) -> Entry:
    """Measure a task as ``stripe-newton bench`` does, in this process."""
    from stripe_newton.cli import bench
    from stripe_newton.cli.run_configs import load_configs

    options = bench.BenchArgs(task, num_envs=num_envs, steps=args.steps, device=args.device)
    return bench.measure(load_configs(task, None, agent=False), options)


def fusion(task: str, num_envs: int, args: argparse.Namespace) -> Entry:
    """Measure the managers of a task as one kernel each, and with a kernel for each term."""
    import torch

    from stripe_newton.cli.device import set_device
    from stripe_newton.cli.run_configs import load_configs
    from stripe_newton.cli.tasks import make_env
    from stripe_newton.envs.fusion_gain import fusion_gain

    cfg = load_configs(task, None, agent=False).env
    cfg.scene.num_envs = num_envs
    set_device(cfg, args.device)
    env = make_env(task, cfg)
    try:
        env.reset(seed=0)
        device = env.unwrapped.device
        name = torch.cuda.get_device_name(device) if device != "cpu" else device
        return {"task": task, "num_envs": num_envs, "device": name, "managers": fusion_gain(env.unwrapped)}
    finally:
        env.close()


def start(task: str, num_envs: int, args: argparse.Namespace) -> Entry:
    """Measure a process that builds a task and takes a step: with an empty kernel cache, and again."""
    result: Entry = {"task": task, "num_envs": num_envs}
    with tempfile.TemporaryDirectory() as cache:
        found = Path(cache) / "bench.json"
        command = [sys.executable, "-m", "stripe_newton.cli", "bench", task, "--import", "stripe_tasks", "--steps", "1"]
        command += ["--num-envs", str(num_envs), "--json", str(found)]
        command += ["--device", args.device] if args.device else []
        variables = {**os.environ, "WARP_CACHE_PATH": cache}
        for name in ("cold", "warm"):
            before = kernel_files(cache)
            subprocess.run(command, env=variables, check=True, stdout=subprocess.DEVNULL)
            after = kernel_files(cache)
            result[name] = {
                **json.loads(found.read_text(encoding="utf-8")),
                "kernel_files": len(after),
                "kernel_files_made": sum(changed != before.get(path) for path, changed in after.items()),
            }
    return result


def kernel_files(cache: str) -> dict[str, int]:
    """Compiled files of a kernel cache, with the times of their last change."""
    endings = (".o", ".cubin", ".ptx", ".fatbin", ".lto")
    return {str(path): path.stat().st_mtime_ns for path in Path(cache).rglob("*") if path.suffix in endings}


def run_part(part: str, out: Path, cases: list[tuple[str, int]], call: Measurement, args: argparse.Namespace) -> None:
    """Measure the cases of a part; results of other cases in ``OUT`` stay."""
    entries = {(e["task"], e["num_envs"]): e for e in load(out, part)}
    for task, num_envs in cases:
        if args.budget and time.perf_counter() - args.began > args.budget:
            print(f"{part}: out of time before {task} at {num_envs}", flush=True)
            return
        began = time.perf_counter()
        try:
            entry = call(task, num_envs, args)
        except Exception as error:  # the others go on
            traceback.print_exc()
            entry = {"task": task, "num_envs": num_envs, "error": f"{type(error).__name__}: {error}"}
        entry["seconds"] = time.perf_counter() - began
        entries[task, num_envs] = entry
        (out / f"{part}.json").write_text(json.dumps(list(entries.values()), indent=1) + "\n", encoding="utf-8")
        print(f"{part}: {task} at {num_envs} took {entry['seconds']:.1f} s {entry.get('error', '')}", flush=True)
        free_memory()


def free_memory() -> None:
    """Give memory back before the next measurement."""
    gc.collect()
    if "torch" in sys.modules:
        import torch

        torch.cuda.empty_cache()


def load(out: Path, part: str) -> list[Entry]:
    """Results of a part in ``OUT``."""
    path = out / f"{part}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


# -- showing


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """A table in Markdown; columns after the first are aligned to the right."""
    return ["| " + " | ".join(head) + " |", "| --- " + "| ---: " * (len(head) - 1) + "|"] + [
        "| " + " | ".join(row) + " |" for row in rows
    ]


def count(value: float | None) -> str:
    """Text of a count; empty if it was not measured."""
    return "" if value is None else f"{value:.3g}"


def step_row(entry: Entry) -> list[str]:
    """Row of a task with the times and calls of its step."""
    head = [f"`{entry['task']}`", f"{entry['num_envs']:,}"]
    if "error" in entry:
        return [*head, entry["error"].splitlines()[0].replace("|", "/"), *[""] * 8]
    low, high = entry["env_range_ms"]
    return [
        *head,
        f"{entry['physics_ms']:.3f}",
        f"{entry['env_ms']:.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{100.0 * entry['overhead_ratio']:.1f} %",
        f"{entry['env_wall_ms']:.3f}",
        f"{entry['env_steps_per_s']:,.0f}",
        *(count(entry[f"{kind}_per_step"]) for kind in ("graph_launches", "kernel_launches", "host_syncs")),
    ]


def fusion_rows(entry: Entry) -> list[list[str]]:
    """Rows of a task with the times of its managers, fused and apart."""
    if "error" in entry:
        return [[f"`{entry['task']}`", f"{entry['num_envs']:,}", entry["error"].splitlines()[0], "", "", "", ""]]
    return [
        [
            f"`{entry['task']}`",
            f"{entry['num_envs']:,}",
            name,
            str(manager["terms"]),
            f"{manager['fused_us']:.1f}",
            f"{manager['apart_us']:.1f}",
            f"{manager['apart_us'] / manager['fused_us']:.1f}",
        ]
        for name, manager in entry["managers"].items()
    ]


def start_rows(entry: Entry) -> list[list[str]]:
    """Rows of a task with the times of its start, cold and warm."""
    names = ("ready_s", "import_s", "build_s", "reset_s", "first_step_s")
    return [
        [f"`{entry['task']}`", f"{entry['num_envs']:,}", name]
        + [f"{entry[name][key]:.2f}" for key in names]
        + [str(entry[name]["kernel_files_made"])]
        for name in ("cold", "warm")
        if name in entry
    ]


def page(out: Path) -> str:
    """All tables that can be made of the results in ``OUT``."""
    steps = ["task", "environments", "physics [ms]", "step [ms]", "range", "over physics", "by the wall [ms]"]
    steps += ["environment steps/s", "graph launches", "kernel launches", "host syncs"]
    fused = ["task", "environments", "manager", "terms", "one kernel [us]", "a kernel a term [us]", "times"]
    begun = ["task", "environments", "cache", "in all [s]", "imports [s]", "build [s]", "reset [s]", "first step [s]"]
    begun += ["compiled"]
    lines: list[str] = []
    for part, head, make in (
        ("tasks", steps, lambda e: [step_row(e)]),
        ("scaling", steps, lambda e: [step_row(e)]),
        ("fusion", fused, fusion_rows),
        ("start", begun, start_rows),
    ):
        rows = [row for entry in load(out, part) for row in make(entry)]
        lines += ["", f"## {part}", "", *table(head, rows)] if rows else []
    devices = {
        e.get("device_name") or e.get("device") for p in ("tasks", "scaling", "fusion") for e in load(out, p)
    } - {None}
    return "\n".join([f"Measured on {', '.join(sorted(devices)) or 'nothing yet'}.", *lines]) + "\n"


def plot_scaling(entries: list[Entry], path: Path) -> None:
    """Draw the time of a step, and its ratio to the physics, against the number of environments."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    times, ratios = figure.subplots(1, 2)
    for index, task in enumerate(dict.fromkeys(e["task"] for e in entries)):
        mine = sorted((e for e in entries if e["task"] == task), key=lambda e: e["num_envs"])
        sizes, color = [e["num_envs"] for e in mine], f"C{index}"
        times.plot(sizes, [e["env_ms"] for e in mine], "o-", color=color, linewidth=1.6, markersize=3, label=task)
        times.plot(sizes, [e["physics_ms"] for e in mine], "--", color=color, linewidth=1.2, label="its physics alone")
        ratio = [1.0 + e["overhead_ratio"] for e in mine]
        ratios.plot(sizes, ratio, "o-", color=color, linewidth=1.6, markersize=3, label=task)
    times.set_yscale("log")
    times.set_ylabel("time of a step (ms)")
    ratios.set_ylabel("step / physics alone")
    ratios.axhline(1.0, color="gray", linewidth=0.8)
    ticks = sorted({e["num_envs"] for e in entries})
    for axes in (times, ratios):
        axes.set_xscale("log", base=4)
        axes.set_xticks(ticks, labels=[f"{size:,}" for size in ticks], rotation=30, fontsize="small")
        axes.set_xlabel("environments")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def show(out: Path) -> str:
    """Write tables and pictures; return the tables."""
    text = page(out)
    (out / "benchmarks.md").write_text(text, encoding="utf-8")
    curves = [e for e in load(out, "scaling") if "error" not in e]
    if curves:
        plot_scaling(curves, out / "scaling.png")
    return text


def main(arguments: list[str]) -> None:
    """Measure the parts and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the results")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    parser.add_argument("--num-envs", type=int, default=4096, help="environments of the part 'tasks'")
    parser.add_argument("--scaling-tasks", nargs="+", default=SCALING_TASKS)
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES, help="environments of the part 'scaling'")
    parser.add_argument("--fusion-tasks", nargs="+", default=["Stripe-Ant-v0"])
    parser.add_argument("--fusion-sizes", nargs="+", type=int, default=FUSION_SIZES)
    parser.add_argument("--start-tasks", nargs="+", default=["Stripe-Ant-v0"])
    parser.add_argument("--steps", type=int, default=320, help="steps to time")
    parser.add_argument("--device", help="cpu or cuda:N; by default the first GPU where there is one")
    parser.add_argument("--budget", type=float, help="seconds after which nothing new is begun")
    args = parser.parse_args(arguments)
    args.began = time.perf_counter()
    args.out.mkdir(parents=True, exist_ok=True)
    cases = {
        "tasks": ([(task, args.num_envs) for task in args.tasks], measure),
        "scaling": ([(task, size) for size in args.sizes for task in args.scaling_tasks], measure),
        "fusion": ([(task, size) for task in args.fusion_tasks for size in args.fusion_sizes], fusion),
        "start": ([(task, args.num_envs) for task in args.start_tasks], start),
    }
    for part in args.parts:
        run_part(part, args.out, *cases[part], args)
        show(args.out)
    print(show(args.out))


if __name__ == "__main__":
    main(sys.argv[1:])
