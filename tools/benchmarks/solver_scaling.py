# SPDX-License-Identifier: Apache-2.0
"""Solver scaling: the fused solver beside MuJoCo Warp, by worlds, degrees of freedom and constraint rows.

    python tools/benchmarks/solver_scaling.py OUT                             # all parts on the first GPU
    python tools/benchmarks/solver_scaling.py OUT --parts worlds --sizes 1 4096
    python tools/benchmarks/solver_scaling.py OUT --device cpu --small        # tries it out
    python tools/benchmarks/solver_scaling.py OUT --parts                     # only table and picture of the results

All figures are milliseconds of the physics of a control step of four physics steps. Parts: ``worlds``, the flat
quadruped's task, measured as ``stripe-newton bench`` does; ``dofs``, a robot of ``solver_scaling_cases.robot_mjcf``
that rests on four spheres and has 0 to 14 limbs in the air; ``rows``, the same robot with four limbs and 0 to 24 of its
24 spheres on the ground. The last two step a ``newton.Model`` with a solver alone, 4096 worlds with targets drawn anew
in every control step; rows and iterations are means over the states that were timed.

Processes build the cases and compile their kernels at the same time, and then measure one after the other. A case that
fails is noted, and the others go on. ``OUT/results.json`` has the numbers, ``OUT/results.md`` the table,
``OUT/solver_scaling.png`` the curves, ``OUT/logs`` what the processes printed. A later call with other parts or sizes
adds to the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Any

Entry = dict[str, Any]
"""Measurement of a case, as ``solver_scaling_cases.py`` writes it."""
Cases = list[Entry]
"""Cases of a process: part, solver and size of each."""

PARTS = ("worlds", "dofs", "rows")
SOLVERS = {"fused": "one kernel", "mujoco_warp": "MuJoCo Warp"}
SIZES = {
    "worlds": [1, 16, 256, 1024, 4096, 16384, 65536],
    "dofs": [0, 2, 4, 6, 8, 10, 12, 14],
    "rows": [0, 4, 8, 12, 16, 20, 24],
}
"""Worlds, limbs, and spheres on the ground."""
SMALL = {"worlds": [1, 4], "dofs": [0, 4], "rows": [0, 8]}
TOGETHER = 2048
"""Worlds up to which one process measures all numbers of them: few are built quickly."""


class Process:
    """Process that builds some cases, waits, and measures them."""

    def __init__(self, name: str, cases: Cases, options: Entry, folder: Path):
        self.name, self._cases = name, cases
        paths = {kind: folder / f"{name}.{kind}" for kind in ("request", "ready", "results", "log")}
        self._ready, self._results, self._log_path = paths["ready"], paths["results"], paths["log"]
        for path in paths.values():
            path.unlink(missing_ok=True)
        request = {"options": options, "cases": cases, "ready": str(self._ready), "out": str(self._results)}
        paths["request"].write_text(json.dumps(request), encoding="utf-8")
        self._log: IO[str] = self._log_path.open("w", encoding="utf-8")
        program = Path(__file__).with_name("solver_scaling_cases.py")
        self._process = subprocess.Popen(
            [sys.executable, str(program), str(paths["request"])],
            stdin=subprocess.PIPE,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            env={"OMP_NUM_THREADS": "1", **os.environ},
            text=True,
        )
        self.problem = ""

    def is_ready(self) -> bool:
        """Whether it has built its cases, or has ended."""
        return self._ready.exists() or self._process.poll() is not None

    def stop(self, problem: str) -> None:
        """End it; ``problem`` is the result of cases that have none."""
        self.problem = problem
        self._process.kill()
        self._process.wait()

    def measure(self, seconds: float) -> list[Entry]:
        """Let it measure its cases for some seconds at most; return their results."""
        if not self.problem:
            try:
                self._process.communicate("go\n", timeout=seconds)
            except subprocess.TimeoutExpired:
                self.stop(f"took longer than {seconds:.0f} s")
            except BrokenPipeError:  # it has ended
                self._process.wait()
        self._log.close()
        found = json.loads(self._results.read_text(encoding="utf-8")) if self._results.exists() else []
        known = {key(entry) for entry in found}
        problem = self.problem or f"the process ended with status {self._process.returncode}: see {self._log_path}"
        return found + [{**case, "error": problem} for case in self._cases if key(case) not in known]


def key(entry: Entry) -> tuple[str, str, int]:
    """Key of a case among all."""
    return entry["part"], entry["solver"], entry["size"]


def processes_of(parts: list[str], sizes: dict[str, list[int]]) -> dict[str, Cases]:
    """Cases of each process by its name: the largest first, since they take longest to build."""
    found: dict[str, Cases] = {}
    for part in parts:
        for size in sorted(sizes[part], reverse=True):
            for solver in SOLVERS:
                few = part == "worlds" and size <= TOGETHER
                name = {"dofs": f"dofs_{size}", "rows": "rows"}.get(part, f"worlds_{solver}_{0 if few else size}")
                found.setdefault(name, []).append({"part": part, "solver": solver, "size": size})
    return {name: cases[::-1] for name, cases in found.items()}


def run(args: argparse.Namespace, sizes: dict[str, list[int]]) -> None:
    """Build all cases at the same time, then measure one process after the other."""
    logs = args.out / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    options = {"device": args.device, "worlds": args.num_worlds, "steps": args.steps, "blocks": args.blocks}
    begun = time.perf_counter()
    waiting = processes_of(args.parts, sizes)
    while waiting:
        group = [Process(name, waiting.pop(name), options, logs) for name in list(waiting)[: args.jobs]]
        print(f"building: {', '.join(process.name for process in group)}", flush=True)
        try:
            wait_for_all(group, args.build_seconds)
            print(f"built after {time.perf_counter() - begun:.0f} s", flush=True)
            for process in group:
                entries = process.measure(args.case_seconds)
                keep(args.out, entries)
                for entry in entries:
                    print(f"{time.perf_counter() - begun:4.0f} s  {line(entry)}", flush=True)
        finally:
            for process in group:
                process.stop("interrupted")


def wait_for_all(group: list[Process], seconds: float) -> None:
    """Wait until all processes are ready; stop those that are not after some seconds."""
    end = time.perf_counter() + seconds
    while not all(process.is_ready() for process in group) and time.perf_counter() < end:
        time.sleep(0.1)
    for process in group:
        if not process.is_ready():
            process.stop(f"was not built after {seconds:.0f} s")


# -- showing


def load(out: Path) -> list[Entry]:
    """Results in ``OUT``."""
    path = out / "results.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else []


def keep(out: Path, entries: list[Entry]) -> None:
    """Add results to those in ``OUT``, in place of earlier ones of the same cases."""
    known = {key(e): e for e in [*load(out), *entries]}
    order = sorted(known.values(), key=lambda e: (PARTS.index(e["part"]), e["size"], e["solver"]))
    (out / "results.json").write_text(json.dumps(order, indent=1) + "\n", encoding="utf-8")


def line(entry: Entry) -> str:
    """A result in a line."""
    text = f"{entry['part']} {entry['size']}, {SOLVERS[entry['solver']]}: "
    return text + (entry.get("error") or f"{entry['ms']:.3f} ms, {entry['rows']:.1f} rows")


def page(entries: list[Entry]) -> str:
    """A table for each part in Markdown."""
    names = {"worlds": "worlds", "dofs": "degrees of freedom", "rows": "constraint rows"}
    devices = sorted({e["device"] for e in entries if "device" in e})
    lines = [f"Physics of a control step. Measured on {', '.join(devices) or 'nothing yet'}."]
    for part in PARTS:
        sizes = sorted({e["size"] for e in entries if e["part"] == part})
        if sizes:
            head = [names[part], "MuJoCo Warp [ms]", "one kernel [ms]", "times", "rows", "iterations"]
            head += ["memory [MiB]", "build [s]", "first step [s]", ""]
            lines += ["", "| " + " | ".join(head) + " |", "| ---: " * (len(head) - 1) + "| --- |"]
            lines += [row(part, *(find(entries, part, solver, size) for solver in SOLVERS)) for size in sizes]
    lines += [
        "",
        "Two numbers in a cell are those of MuJoCo Warp and of one kernel. The first step includes loading or",
    ]
    lines += ["compiling kernels, while the other cases were built."]
    return "\n".join(lines) + "\n"


def find(entries: list[Entry], part: str, solver: str, size: int) -> Entry:
    """The result of a case; empty if there is none."""
    return next((e for e in entries if key(e) == (part, solver, size)), {})


def row(part: str, fused: Entry, warp: Entry) -> str:
    """Row of the results of both solvers at one size."""
    pair = [warp, fused]

    def both(name: str, form: str) -> str:
        texts = [format(e[name], form) if e.get(name) is not None else "-" for e in pair]
        return texts[0] if texts[0] == texts[1] else " / ".join(texts)

    def one(entry: Entry) -> str:
        return f"{entry['ms']:.3f}" if "ms" in entry else "-"

    size = next((e[SCALE[part]] for e in pair if SCALE[part] in e), next(e["size"] for e in pair if e))
    times = f"{warp['ms'] / fused['ms']:.1f}" if "ms" in warp and "ms" in fused else ""
    notes = [f"{SOLVERS[e['solver']]}: {e['error']}" for e in pair if "error" in e]
    notes += [f"{SOLVERS[e['solver']]}: not finite" for e in pair if not e.get("finite", True)]
    notes += [] if fused.get("physics", "the fused step").startswith("the fused step") else [fused["physics"]]
    cells = [f"{size:,.0f}", one(warp), one(fused), times, both("rows", ".1f"), both("iterations", ".1f")]
    cells += [both("memory_mb", ",.0f"), both("build_s", ".1f"), both("first_step_s", ".1f")]
    return "| " + " | ".join([*cells, "; ".join(notes).replace("|", "/")]) + " |"


SCALE = {"worlds": "num_worlds", "dofs": "nv", "rows": "rows"}
"""Key of the numbers on the horizontal axis of a part."""


def plot(entries: list[Entry], path: Path) -> None:
    """Draw the time of both solvers by worlds, by degrees of freedom and by rows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    worlds = {e["num_worlds"] for e in entries if e["part"] != "worlds"}
    where = f"{', '.join(f'{w:,}' for w in sorted(worlds))} worlds" if worlds else ""
    titles = ("flat quadruped", where, f"18 degrees of freedom, {where}" if where else "")
    for axes, part, title in zip(panels, PARTS, titles, strict=True):
        for solver, color in (("mujoco_warp", "C1"), ("fused", "C0")):
            mine = [e for e in entries if (e["part"], e["solver"]) == (part, solver)]
            points = sorted((e[SCALE[part]], e["ms"]) for e in mine)
            if points:
                axes.plot(*zip(*points), "o-", color=color, linewidth=1.6, markersize=3, label=SOLVERS[solver])
        axes.set(xlabel={"worlds": "worlds", "dofs": "degrees of freedom", "rows": "constraint rows"}[part])
        axes.set_title(title, fontsize="medium")
        axes.grid(alpha=0.3)
        if axes.lines:
            axes.legend(fontsize="small")
    panels[0].set(xscale="log", yscale="log", ylabel="physics of a control step (ms)")
    sizes = sorted({e["num_worlds"] for e in entries if e["part"] == "worlds"})
    panels[0].set_xticks(sizes, labels=[f"{size:,}" for size in sizes], rotation=30, fontsize="small")
    panels[0].minorticks_off()
    for axes in panels[1:]:
        axes.set_ylim(bottom=0.0)
    figure.savefig(path, dpi=120)


def show(out: Path) -> str:
    """Write table and picture; return the table."""
    entries = load(out)
    text = page(entries)
    (out / "results.md").write_text(text, encoding="utf-8")
    curves = [e for e in entries if "ms" in e]
    if curves:
        plot(curves, out / "solver_scaling.png")
    return text


def parse(arguments: list[str]) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the results")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--sizes", nargs="+", type=int, help="worlds, limbs or spheres, if there is one part")
    parser.add_argument("--num-worlds", type=int, default=4096, help="worlds of the parts 'dofs' and 'rows'")
    parser.add_argument("--steps", type=int, default=16, help="control steps in a block")
    parser.add_argument("--blocks", type=int, default=5, help="blocks of which the median is taken")
    parser.add_argument("--device", default="cuda:0", help="cpu or cuda:N")
    parser.add_argument("--small", action="store_true", help="few small cases, to try it out")
    parser.add_argument("--jobs", type=int, default=32, help="processes at a time; all build before any measures")
    parser.add_argument("--build-seconds", type=float, default=300.0, help="most time for building all cases")
    parser.add_argument("--case-seconds", type=float, default=120.0, help="most time for measuring in a process")
    args = parser.parse_args(arguments)
    if args.sizes and len(args.parts) != 1:
        parser.error("--sizes: needs one part, as in --parts worlds")
    if args.small:
        args.num_worlds, args.steps, args.blocks = min(args.num_worlds, 4), min(args.steps, 4), min(args.blocks, 2)
    return args


def main(arguments: list[str]) -> None:
    """Measure the parts, then show all results in OUT."""
    args = parse(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    sizes = dict(SMALL if args.small else SIZES)
    if args.sizes:
        sizes[args.parts[0]] = args.sizes
    run(args, sizes)
    print(show(args.out))


if __name__ == "__main__":
    main(sys.argv[1:])
