# SPDX-License-Identifier: Apache-2.0
"""Mutation check: damage valid USD stages at random, load each in a process of its own, and report what happens.

    python tools/checks/mutate_files.py OUT [--count 300] [--seed 0] [--workers 2] [--timeout 60]

A damaged stage may load (inspected, built, stepped, drawn and exported), be refused by one clear error, or diverge and
be told so by a step. It must never end in a traceback of another kind, a crash of the process or a wait without end.
OUT gets the damaged files and ``record.json``; the command fails if one of them did.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).parent))

from stage_damage import Case, damaged_files

BAD = ("traceback", "crash", "hang")
"""Outcomes that must not be."""
START_S = 60.0
"""Seconds more for the first file of a process, which pays for its imports and kernels too."""


def trial(path: str) -> tuple[str, str]:
    """Inspect, build, step, draw and export a stage; the outcome and its text."""
    import traceback

    from stripe_newton.scene import InteractiveScene
    from stripe_newton.sim import SimulationCfg
    from stripe_newton.usd import StageError, inspect_stage
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    try:
        inspect_stage(path).to_text()
        scene = InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(gravity=None, device="cpu"))
        try:
            SceneRenderer(scene.sim, ViewerCfg(resolution=(32, 24))).render()
            scene.export(Path(path).with_suffix(".out.usda"))
            scene.sim.step(20)
            scene.sim.begin_step()
        finally:
            scene.close()
    except StageError as error:
        return "refused", str(error)
    except FloatingPointError as error:
        return "diverges", str(error)
    except RuntimeError as error:
        if "overflow" in str(error):
            return "refused", str(error)
        return "traceback", traceback.format_exc()
    except Exception:
        return "traceback", traceback.format_exc()
    finally:
        Path(path).with_suffix(".out.usda").unlink(missing_ok=True)
    return "loads", ""


def work() -> None:
    """Try the files named on standard input, one a line, and print a line of JSON for each."""
    import warnings

    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        print(json.dumps(trial(line.strip())), file=answers, flush=True)


class Worker:
    """A process that tries files one after the other; started anew after a crash and after a hang."""

    def __init__(self, timeout: float):
        self._timeout = timeout
        self._process: subprocess.Popen[str] | None = None
        self._fresh = True

    def try_file(self, case: Case) -> None:
        """Fill in the outcome of a case."""
        if self._process is None:
            command = [sys.executable, __file__, "--work"]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
            self._fresh = True
        process, start = self._process, time.monotonic()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(case.file + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], self._timeout + (START_S if self._fresh else 0.0))
        self._fresh = False
        line = process.stdout.readline() if ready else ""
        case.seconds = time.monotonic() - start
        if line:
            case.outcome, case.text = json.loads(line)
            return
        if ready:
            code = process.wait()
            case.outcome, case.text = "crash", signal.Signals(-code).name if code < 0 else f"exit status {code}"
        else:
            process.kill()
            case.outcome, case.text = "hang", f"no answer within {self._timeout:g} s"
        self.close()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def run_cases(cases: list[Case], workers: int = 2, timeout: float = 60.0) -> None:
    """Try all cases, each in a process that may crash or hang."""
    todo: SimpleQueue[Case | None] = SimpleQueue()
    for case in cases:
        todo.put(case)
    for _ in range(workers):
        todo.put(None)

    def serve(_: int) -> None:
        worker = Worker(timeout)
        try:
            while (case := todo.get()) is not None:
                worker.try_file(case)
        finally:
            worker.close()

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(serve, range(workers)))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the damaged files and the record")
    parser.add_argument("--count", type=int, default=300, help="number of damaged files")
    parser.add_argument("--seed", type=int, default=0, help="seed of the damage")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time")
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds that a file may take")
    args = parser.parse_args()
    cases = damaged_files(args.out, args.count, args.seed)
    run_cases(cases, args.workers, args.timeout)
    (args.out / "record.json").write_text(json.dumps([asdict(case) for case in cases], indent=1))
    for outcome, number in Counter(case.outcome for case in cases).most_common():
        print(f"{number:6d}  {outcome}")
    bad = [case for case in cases if case.outcome in BAD]
    for case in bad:
        print(f"{case.outcome}: {case.file} ({case.source}, {case.damage}): {case.text.strip().splitlines()[-1:]}")
    return 1 if bad else 0


if __name__ == "__main__":
    if sys.argv[1:] == ["--work"]:
        work()
    else:
        sys.exit(main())
