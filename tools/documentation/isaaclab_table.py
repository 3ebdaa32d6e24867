# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab table: the tables at the end of docs/isaac_lab.md, of tasks and scripts of Isaac Lab that run.

    python tools/documentation/isaaclab_table.py SOURCE --tasks FILE ... --scripts FILE [--output PAGE]

``SOURCE`` is the folder that holds ``isaaclab_tasks/`` and ``isaaclab_assets/``. The files are what
``tools/checks/isaaclab_runs.py`` and ``tools/checks/isaaclab_scripts.py`` keep with ``--out``. Registered tasks without
an outcome are in the table as not tried.
"""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "checks"))

import isaaclab_runs
import isaaclab_scripts

import stripe_newton.isaaclab as dialect

PAGE = Path(__file__).parents[2] / "docs" / "isaac_lab.md"
MARK = "<!-- Written by tools/documentation/isaaclab_table.py from here to the end. -->"
PARTS = {"manager_based": "Manager-based tasks", "direct": "Direct tasks"}
NOT_TRIED = "not tried"

_REASONS = (
    (r".*'Robots/(.+?)/[^/]*': .*", r"no file of the robot `\1`"),
    (r".*'IsaacLab/Robots/(.+?)/[^/]*': .*", r"no file of the robot `\1`"),
    (r".*Agility Digit.*", "no file of the robot `Agility/Digit`"),
    (r".*?'((?:Props|IsaacLab|Environments|Samples)/[^']*)': .*", r"no file `\1`"),
    (r".*nucleus://Isaac/(\S+?)['\" ].*", r"no file `\1`"),
    (r".*?'?(\w+)'? is not supported: (.*?)(?:; it was called once.*| \w[\w.]*: .*)?", r"`\1`: \2"),
    (r"ModuleNotFoundError: No module named '(\w+)'.*", r"needs the package `\1`"),
    (r".*: models\S*: (.*); train this task with skrl itself.*", r"no agent of rsl_rl; that of skrl: \1"),
    (r".*returned shape .*, must be \(num_envs, size\) = .*", "the shape of an observation term changes"),
    (r".*: no body or site at '[^']*/(\w+)'.*", r"the robot's file has no body `\1`"),
    (r".*'NoneType' object has no attribute 'default'", "changes prims of every environment; the stage has one"),
    (r"SystemExit: 2", "needs an option with a file of the user's"),
    (r"the process ended with .*|took more than .*", r"\g<0>"),
)
"""Messages by expression, and what the table says in their place."""


def reason(text: str) -> str:
    """Why a task or script fails, in a few words; ``"yes"`` if it does not."""
    if text in ("ok", "", NOT_TRIED, isaaclab_runs.NO_AGENT):
        return {"ok": "yes", isaaclab_runs.NO_AGENT: "no agent of rsl_rl"}.get(text, text)
    for pattern, short in _REASONS:
        if match := re.fullmatch(pattern, text):
            return match.expand(short)
    short = text if len(text) <= 100 else text[:97] + "..."
    return short.replace("|", "/")


def task_table(outcomes: Iterable[isaaclab_runs.Outcome], part: str) -> str:
    """Table of the files in a folder: their tasks, whether they run, whether they train."""
    rows: dict[tuple[str, str, str], list[str]] = {}
    for outcome in outcomes:
        file = outcome.file.removeprefix(f"{part}/").removesuffix(".py")
        rows.setdefault((file, reason(outcome.steps), reason(outcome.train)), []).append(_short(outcome.task))
    lines = [f"| file in `{part}/` | tasks | runs | trains |", "|---|---|---|---|"]
    lines += [f"| `{file}` | {', '.join(tasks)} | {steps} | {train} |" for (file, steps, train), tasks in rows.items()]
    return "\n".join(lines)


def _short(task: str) -> str:
    return "`" + task.removeprefix("Isaac-").removesuffix("-v0") + "`"


def _task_section(part: str, title: str, kept: Mapping[str, isaaclab_runs.Outcome]) -> str:
    known = isaaclab_runs.tasks_of(part)
    every = [kept.get(task, isaaclab_runs.Outcome(task, file, NOT_TRIED)) for task, file in known.items()]
    tried = [outcome for outcome in every if outcome.steps != NOT_TRIED]
    run, trained = (sum(getattr(o, what) == "ok" for o in tried) for what in ("steps", "train"))
    text = f"Of {len(every)} registered tasks {len(tried)} were tried: {run} run, {trained} of these train."
    return f"## {title}\n\n{text}\n\n{task_table(every, part)}\n"


def _script_section(outcomes: Iterable[isaaclab_scripts.Outcome]) -> str:
    rows = sorted(outcomes, key=lambda outcome: outcome.script)
    lines = [f"| `{o.script.removesuffix('.py')}` | {reason(o.runs)} |" for o in rows]
    run = sum(o.runs == "ok" for o in rows)
    head = f"## Tutorials and demos\n\n{run} of {len(rows)} scripts run as they are, with a picture each."
    return "\n".join([head, "", "| script | runs |", "|---|---|", *lines]) + "\n"


def main() -> int:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--tasks", type=Path, nargs="+", required=True)
    parser.add_argument("--scripts", type=Path, required=True)
    parser.add_argument("--output", type=Path, default=PAGE)
    args = parser.parse_args()
    own, mark, _ = PAGE.read_text().partition(MARK)
    if not mark:
        parser.error(f"{PAGE} has no line {MARK}")
    os.environ["ISAACLAB_SOURCE"] = str(args.source.resolve())
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    dialect.install()
    kept = isaaclab_runs.kept_outcomes(args.tasks)
    sections = [_task_section(part, title, kept) for part, title in PARTS.items()]
    scripts = _script_section(isaaclab_scripts.kept_outcomes(args.scripts))
    args.output.write_text(own + MARK + "\n\n" + "\n".join([*sections, scripts]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
