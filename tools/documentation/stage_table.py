# SPDX-License-Identifier: Apache-2.0
"""Stage table: write docs/stages.md, the outcome of loading and stepping every USD stage of the installed Newton.

python tools/documentation/stage_table.py [--output docs/stages.md]
"""

from __future__ import annotations

import argparse
from importlib.metadata import version
from pathlib import Path

import newton

from stripe_newton.usd.stage_trial import try_stage

FOLDERS = ("examples/assets", "tests/assets")
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def main() -> None:
    """Try every stage and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).parents[2] / "docs" / "stages.md")
    output = parser.parse_args().output
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
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text("\n".join(lines))


if __name__ == "__main__":
    main()
