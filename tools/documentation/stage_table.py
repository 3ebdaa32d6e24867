# SPDX-License-Identifier: Apache-2.0
"""Stage table: write docs/stages.md, the outcome of loading and stepping stages and robots' files.

    python tools/documentation/stage_table.py [--output docs/stages.md]
    python tools/documentation/stage_table.py --foreign RECORD [--source NAME=FOLDER ...]

The first writes the part on the stages of the installed Newton. The second tries the files of
``foreign_files.txt`` that lie below the folders, adds what it finds to the record, and writes the part on them. Rows of
files that the record does not have stay.
"""

from __future__ import annotations

import argparse
import sys
from importlib.metadata import version
from pathlib import Path

import newton

sys.path.insert(0, str(Path(__file__).parent))

from foreign_table import HEADING, foreign_section, try_foreign_files

from stripe_newton.usd.stage_trial import try_stage

FOLDERS = ("examples/assets", "tests/assets")
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def main() -> None:
    """Write the part that was asked for; the other stays."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[2] / "docs" / "stages.md")
    parser.add_argument("--foreign", type=Path, help="record of the files of other projects")
    parser.add_argument("--source", action="append", default=[], help="folder of a source of the list, NAME=FOLDER")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds that a foreign file may take")
    parser.add_argument("--workers", type=int, default=2, help="processes that try foreign files at a time")
    args = parser.parse_args()
    own, heading, foreign = (args.output.read_text() if args.output.exists() else "").partition(HEADING)
    if args.foreign is not None:
        folders = {name: Path(folder) for name, _, folder in (pair.partition("=") for pair in args.source)}
        try_foreign_files(folders, args.foreign, args.timeout, args.workers)
        foreign = "\n".join(foreign_section(args.foreign, foreign))
    else:
        own, foreign = "\n".join([*newton_section(), ""]), heading + foreign
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text(f"{own.rstrip()}\n\n{foreign}" if foreign else own)


def newton_section() -> list[str]:
    """Try every stage of Newton; lines of the part on them."""
    package = Path(newton.__file__).parent
    paths = sorted(p for folder in FOLDERS for p in (package / folder).rglob("*") if p.suffix in SUFFIXES)
    rows = []
    for path in paths:
        trial = try_stage(path)
        name = path.relative_to(package).as_posix()
        print(f"{trial.outcome:9} {name} {trial.reason}", flush=True)
        numbers = [str(n) if trial.outcome == "steps" else "" for n in (trial.bodies, trial.dofs, trial.shapes)]
        rows.append([f"`{name}`", trial.outcome, *numbers, trial.reason.replace("|", "\\|")])
    stepped = sum(row[1] == "steps" for row in rows)
    lines = [
        "# Stages of the installed Newton",
        "",
        f"Every USD stage that newton {version('newton')} ships: loaded with `load_stage`, two worlds, 200 steps of "
        "1/240 s with SolverMuJoCo on the CPU. *steps* means that after every step all joint and body states were "
        f"finite; *refused* gives the reason. {stepped} of {len(rows)} step.",
        "",
        "`tests/usd/test_stages.py` holds the same table to account; "
        "`python tools/documentation/stage_table.py` writes this page.",
        "",
        "| stage | outcome | bodies | dofs | shapes | reason |",
        "| --- | --- | ---: | ---: | ---: | --- |",
        *(f"| {' | '.join(row)} |" for row in rows),
        "",
    ]
    return lines


if __name__ == "__main__":
    main()
