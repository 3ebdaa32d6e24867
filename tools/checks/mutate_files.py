# SPDX-License-Identifier: Apache-2.0
"""Mutation check: damage valid USD, URDF and MJCF files at random, load each in a process of its own, and report.

    python tools/checks/mutate_files.py OUT [--count 300] [--seed 0] [--workers 2] [--timeout 60]

A damaged file may load (inspected, built, stepped, drawn and exported), be refused by one clear error, or diverge and
be told so by a step. It must never end in a traceback of another kind, a crash of the process or a wait without end.
OUT gets the damaged files and ``record.json``; the command fails if one of them did.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from file_worker import BAD, Answer, answer_each_line, try_files
from stage_damage import Case, damaged_files


def trial(path: str) -> tuple[str, str, dict[str, Any]]:
    """Inspect, build, step, draw and export a file; the outcome and its text."""
    import traceback

    from file_trial import file_scene

    from stripe_newton.configclass import ConfigError
    from stripe_newton.robot_files import RobotFileError, file_kind, inspect_robot_file
    from stripe_newton.usd import StageError, inspect_stage
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    robot = Path(path).suffix in (".urdf", ".xml")
    try:
        (inspect_robot_file(path) if robot else inspect_stage(path)).to_text()
        scene = file_scene(path, file_kind(path).name if robot else "")
        try:
            SceneRenderer(scene.sim, ViewerCfg(resolution=(32, 24))).render()
            scene.export(Path(path).with_suffix(".out.usda"))
            scene.sim.step(20)
            scene.sim.begin_step()
        finally:
            scene.close()
    except (StageError, RobotFileError, ConfigError) as error:
        return "refused", str(error), {}
    except FloatingPointError as error:
        return "diverges", str(error), {}
    except RuntimeError as error:
        if "overflow" in str(error):
            return "refused", str(error), {}
        return "traceback", traceback.format_exc(), {}
    except Exception:
        return "traceback", traceback.format_exc(), {}
    finally:
        Path(path).with_suffix(".out.usda").unlink(missing_ok=True)
    return "loads", "", {}


def run_cases(cases: list[Case], workers: int = 2, timeout: float = 60.0) -> None:
    """Try all cases, each in a process that may crash or hang, and fill in their outcomes."""

    def tell(index: int, answer: Answer) -> None:
        case = cases[index]
        case.outcome, case.text, case.seconds = answer.outcome, answer.text, answer.seconds

    try_files([case.file for case in cases], [sys.executable, __file__, "--work"], workers, timeout, tell)


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
        answer_each_line(trial)
    else:
        sys.exit(main())
