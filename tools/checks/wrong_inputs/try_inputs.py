# SPDX-License-Identifier: Apache-2.0
"""Wrong inputs: configs, options, files, places, modules and calls that are wrong, tried by thousands, and a table.

    python tools/checks/wrong_inputs/try_inputs.py OUT [--count 3000] [--seed 0] [--workers 1] [--timeout 60]
    python tools/checks/wrong_inputs/try_inputs.py OUT2 --again OUT/record.json

Each input may turn out to be right, or be refused by one message that names it. A traceback, a crash, a wait without
end, and a wrong input that is taken in silence are errors, and the command fails. OUT gets ``table.md``,
``record.json`` with every input and its answer, and the two short trainings whose run folders are damaged. A command
that was ended early goes on where it stopped when it is given again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

from case import BAD, Case, table
from file_worker import Answer, answer_each_line, try_files

__all__ = ["make_cases", "make_templates", "try_cases"]

TASKS = ("Stripe-Cartpole-Direct-v0", "Stripe-Cartpole-v0")


def make_cases(count: int, seed: int) -> list[Case]:
    """About ``count`` cases of all groups; the same seed gives the same ones."""
    # Here, as they load all of the project.
    from call_cases import call_cases
    from command_cases import command_cases
    from config_cases import config_cases
    from file_cases import file_cases
    from odd_cases import odd_cases
    from process_cases import process_cases
    from term_cases import term_cases

    rng = random.Random(seed)
    makers = config_cases, command_cases, file_cases, call_cases, term_cases, process_cases, odd_cases
    cases = [case for make in makers for case in make(rng, count)]
    rng.shuffle(cases)  # so that what is done when a run is ended early is a share of each group
    return cases


def bad_cases(record: Path) -> list[Case]:
    """Cases of a record, or of a log of answers, that ended as none must, or by a message that is not clear."""
    text = record.read_text()
    found = json.loads(text) if text.startswith("[") else [json.loads(line) for line in text.splitlines()]
    bad = [Case(**case) for case in found if case["outcome"] in (*BAD, "unclear")]
    for case in bad:
        case.outcome = case.text = ""
    return bad


def take_answers(cases: list[Case], log: Path) -> None:
    """Take the outcomes of an earlier command that was ended early from its log, for the cases that it tried."""
    waiting: dict[str, list[Case]] = {}
    for case in cases:
        waiting.setdefault(_question(case), []).append(case)
    for line in log.read_text().splitlines():
        answered = Case(**json.loads(line))
        same = waiting.get(_question(answered))
        if not same:
            sys.exit(f"{log}: has an answer to {answered.what!r}, which is none of these inputs; use another folder")
        case = same.pop()
        case.outcome, case.text, case.seconds = answered.outcome, answered.text, answered.seconds


def _question(case: Case) -> str:
    return json.dumps([case.group, case.what, case.data])


def make_templates(out: Path) -> dict[str, str]:
    """Run folders of short trainings by task, each with two checkpoints and an exported policy."""
    found: dict[str, str] = {}
    for task in TASKS:
        logs = out / "templates" / task
        if not logs.exists():
            words = ["--num-envs", "4", "--max-iterations", "2", "--device", "cpu", "--final-video", "False"]
            words += ["--agent.save-interval", "1", "--log-dir", str(logs), "--agent.num-steps-per-env", "8"]
            command = [sys.executable, "-m", "stripe_newton.cli", "train", task, *words]
            subprocess.run(command, check=True, capture_output=True)
        found[task] = str(next(logs.glob("*/*")).resolve())
    big = out / "templates" / "big.zip"
    if not big.exists():
        from recipes import make_big_zip  # here, as it loads torch

        make_big_zip(big)
    return found | {"big_zip": str(big.resolve())}


def try_cases(
    cases: list[Case], templates: dict[str, str], workers: int = 1, timeout: float = 60.0, log: Path | None = None
) -> None:
    """Try the cases that have no outcome yet, and fill it in; each answer goes to the log at once, a line of JSON."""
    cases = [case for case in cases if not case.outcome]
    began = time.monotonic()

    def tell(index: int, answer: Answer) -> None:
        case = cases[index]
        case.outcome, case.text, case.seconds = answer.outcome, answer.text, answer.seconds
        if log is not None:
            with open(log, "a") as file:
                file.write(json.dumps(asdict(case)) + "\n")
        if index % 100 == 0:
            print(f"{index}/{len(cases)} {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)

    lines = [json.dumps(asdict(case)) for case in cases]
    command = [sys.executable, __file__, "--work", json.dumps(templates), str(timeout)]
    # The process tells of hangs itself; this time is for when it does not.
    try_files(lines, command, workers, timeout + 30.0, tell)


def work(templates: str, timeout: str) -> None:
    """Answer cases from the standard input."""
    from trials import Trials

    answer_each_line(Trials(json.loads(templates), float(timeout)).try_case)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=3000, help="number of inputs, about")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes at a time")
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds that an input may take")
    parser.add_argument("--group", default="", help="only groups whose name contains this")
    parser.add_argument("--again", type=Path, help="try the inputs of a record once more that ended badly")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    args.out.mkdir(parents=True, exist_ok=True)
    cases = make_cases(args.count, args.seed) if args.again is None else bad_cases(args.again)
    cases = [case for case in cases if args.group in case.group]
    log = args.out / "answers.jsonl"
    if log.exists():
        take_answers(cases, log)
    try_cases(cases, make_templates(args.out), args.workers, args.timeout, log)
    (args.out / "record.json").write_text(json.dumps([asdict(case) for case in cases], indent=1))
    (args.out / "table.md").write_text(table(cases))
    print(table(cases))
    bad = [case for case in cases if case.outcome in BAD]
    for case in bad:
        print(f"{case.outcome}: {case.group}: {case.what}: {case.text.strip().splitlines()[-1:]}")
    return 1 if bad else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:])
    else:
        sys.exit(main())
