# SPDX-License-Identifier: Apache-2.0
"""Start: where the seconds of a training go that are none of its iterations, from the command to its end.

    python tools/benchmarks/start.py [TASK] [--runs 3] [--cold] [--imports] [OPTIONS OF TRAIN]
    python tools/benchmarks/start.py Stripe-Velocity-Flat-Quadruped-v0 --num-envs 4096 --final-video False

Each run is ``stripe-newton train TASK --max-iterations 1`` in a process of its own. The table has the time by the wall
and that of the processor, each the smallest over the runs: on a machine that others use, compare the second.
``--cold`` starts with an empty kernel cache, and adds a table of the kernel modules of the last run: when its process,
or one that it started, began to compile each, and for how long. ``--imports`` adds the packages that take longest to
import.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

PHASES = {
    "imports": "imports",
    "configs": "configs of the task, with their modules",
    "parse": "options",
    "scene": "scene, model and solver",
    "kernels": "kernels: hashes, loading, compiling",
    "env": "the rest of the environment",
    "learner": "networks and learner",
    "first": "first iteration",
    "curve": "learning curve",
    "export": "export of the policy",
    "video": "video",
    "rest": "the rest",
}
"""Text of each phase, in the order of the table."""
BEFORE_FIRST = ("imports", "configs", "parse", "scene", "kernels", "env", "learner")
"""Phases from the command to the first step."""

# -- in the process that trains


class Clock:
    """Seconds by phase, by the wall and of the processor; a phase within another one is taken out of it."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
        self._open = ["rest"]
        # The processor's clock begins with the process, and so do the imports.
        self._last = (time.perf_counter(), 0.0)

    def _count(self) -> None:
        now = (time.perf_counter(), _processor_s())
        for k in range(2):
            self.seconds[self._open[-1]][k] += now[k] - self._last[k]
        self._last = now

    def begin(self, phase: str) -> None:
        """Begin a phase."""
        self._count()
        self._open.append(phase)

    def end(self) -> None:
        """End the phase that was begun last."""
        self._count()
        self._open.pop()

    def time(self, owner: object, name: str, phase: str) -> None:
        """Count the calls of a function as a phase."""
        function: Callable[..., object] = getattr(owner, name)

        @functools.wraps(function)
        def timed(*args: object, **kwargs: object) -> object:
            self.begin(phase)
            try:
                return function(*args, **kwargs)
            finally:
                self.end()

        setattr(owner, name, timed)


def _processor_s() -> float:
    """Seconds of the processor, of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def train(words: list[str]) -> int:
    """Train in this process, and write the seconds by phase to the file that the environment names."""
    clock = Clock()
    clock.begin("imports")
    import gc

    # All that the command does with the arguments of the process alone, as it is told others below.
    gc.disable()
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from stripe_newton.cli import _device_of, main
    from stripe_newton.cli.early_libraries import load_early
    from stripe_newton.cli.kernel_warmup import start_early
    from stripe_newton.cli.quick_imports import import_quickly

    start_early(device := _device_of("train", words))
    load_early(device, words)
    import_quickly()
    from stripe_newton.cli import train

    clock.end()
    clock.time(train, "load_configs", "configs")
    clock.time(train, "parse", "parse")
    clock.time(train, "_build_runner", "learner")
    clock.time(train, "plot_learning_curve", "curve")
    clock.time(train, "export_policy", "export")
    clock.time(train, "record_video", "video")
    clock.time(train.OnPolicyRunner, "learn", "first")

    import warp as wp

    import stripe_newton.cli.env_and_policy as parts
    from stripe_newton.scene import InteractiveScene

    clock.time(parts, "make_env", "env")
    clock.time(parts, "warm_up", "kernels")
    clock.time(InteractiveScene, "build", "scene")
    clock.time(wp.Module, "load", "kernels")
    code = main(["train", *words])
    clock.begin("rest")
    clock.end()
    Path(os.environ["START_SECONDS"]).write_text(json.dumps(clock.seconds), encoding="utf-8")
    return code


# -- in the process that measures


class Module(NamedTuple):
    """A kernel module that was compiled."""

    name: str
    began: float
    """When the compiler got its source [s], from the command on."""
    seconds: float
    """Time until its binary was there [s]."""


def compiled_modules(cache: Path, start: float) -> list[Module]:
    """Modules in a kernel cache, the first one first, of which Warp keeps the source beside the binary.

    Args:
        cache: Folder of the cache.
        start: Time of the command, as of :func:`time.time`.
    """
    modules = []
    for source in (f for f in cache.rglob("wp_*/*") if f.suffix in (".cu", ".cpp")):
        began = source.stat().st_mtime
        binaries = [f for f in source.parent.iterdir() if f.suffix in (".cubin", ".ptx", ".o")]
        if binaries:
            seconds = max(f.stat().st_mtime for f in binaries) - began
            modules.append(Module(source.stem.removeprefix("wp_"), began - start, seconds))
    return sorted(modules, key=lambda module: module.began)


def measure(task: str, options: list[str], cold: bool) -> tuple[dict[str, list[float]], list[Module]]:
    """Seconds by phase, wall and processor, of one training of one iteration; and the modules that were compiled."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = Path(folder) / "seconds.json"
        environment = os.environ | {"START_SECONDS": str(seconds)}
        if cold:
            environment["WARP_CACHE_PATH"] = f"{folder}/kernels"
        words = [task, "--max-iterations", "1", "--log-dir", f"{folder}/logs", *options]
        command = [sys.executable, __file__, "--in-process", *words]
        start = time.time()
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        found: dict[str, list[float]] = json.loads(seconds.read_text(encoding="utf-8"))
        modules = compiled_modules(Path(folder) / "kernels", start)
    return found, modules


def table_of_modules(modules: list[Module]) -> str:
    """Markdown table of compiled modules, with the total."""
    lines = ["| module | began at [s] | compiled in [s] |", "| --- | ---: | ---: |"]
    lines += [f"| {m.name} | {m.began:.1f} | {m.seconds:.2f} |" for m in modules]
    return "\n".join([*lines, f"| all {len(modules)} | | {sum(m.seconds for m in modules):.1f} |"])


def import_times() -> list[tuple[str, float]]:
    """Seconds that the modules of each package take to import themselves, for ``train``, the longest first."""
    code = "import gc; gc.disable(); from stripe_newton.cli.quick_imports import import_quickly; import_quickly(); "
    code += "import stripe_newton.cli.train, stripe_tasks.velocity.quadruped"
    ran = subprocess.run([sys.executable, "-X", "importtime", "-c", code], capture_output=True, text=True, check=True)
    packages: dict[str, float] = defaultdict(float)
    for line in ran.stderr.splitlines():
        found = re.match(r"import time:\s*(\d+) \|\s*\d+ \|\s*(\S+)", line)
        if found is not None:
            name = found[2].split(".")
            packages[".".join(name[:2]) if name[0] == "torch" else name[0]] += int(found[1]) / 1e6
    return sorted(packages.items(), key=lambda item: -item[1])


def table(runs: list[dict[str, list[float]]]) -> str:
    """Markdown table of the phases."""
    lines = ["| | wall [s] | processor [s] |", "| --- | ---: | ---: |"]
    best = {p: [min(run.get(p, [0.0, 0.0])[k] for run in runs) for k in range(2)] for p in PHASES}
    for phase, text in PHASES.items():
        if any(phase in run for run in runs):
            lines.append(f"| {text} | {best[phase][0]:.2f} | {best[phase][1]:.2f} |")
        if phase == BEFORE_FIRST[-1]:
            wall, processor = (sum(best[p][k] for p in BEFORE_FIRST) for k in range(2))
            lines.append(f"| **from the command to the first step** | **{wall:.2f}** | **{processor:.2f}** |")
    wall, processor = (sum(best[p][k] for p in PHASES) for k in range(2))
    return "\n".join([*lines, f"| all | {wall:.2f} | {processor:.2f} |"])


def main() -> int:
    """Measure and print."""
    if sys.argv[1:2] == ["--in-process"]:
        return train(sys.argv[2:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", nargs="?", default="Stripe-Velocity-Flat-Quadruped-v0")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--cold", action="store_true")
    parser.add_argument("--imports", action="store_true")
    args, options = parser.parse_known_args()
    load = os.getloadavg()[0]
    measured = [measure(args.task, options, args.cold) for _ in range(args.runs)]
    runs = [seconds for seconds, _ in measured]
    print(f"{args.task} {' '.join(options)}: {args.runs} runs, {os.cpu_count()} cores, load {load:.1f} before\n")
    print(table(runs))
    if args.cold:
        print(f"\n{table_of_modules(measured[-1][1])}")
    if args.imports:
        print("\n| package | import [s], by the wall |\n| --- | ---: |")
        for name, seconds in import_times()[:20]:
            print(f"| {name} | {seconds:.2f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
