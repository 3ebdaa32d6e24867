# SPDX-License-Identifier: Apache-2.0
"""Scripts of Isaac Lab under the dialect: runs tutorials and demos unmodified, with a picture of each.

    python tools/checks/isaaclab_scripts.py SCRIPTS [NAME ...] [--steps N] [--pictures FOLDER] [--out FILE]

``SCRIPTS`` is the folder ``scripts`` of Isaac Lab; ``NAME`` names scripts below it, by default all in ``tutorials`` and
``demos``. ``ISAACLAB_SOURCE`` names Isaac Lab's folder ``source``, for scripts that import its tasks and robots. Each
script runs without a window, in a process of its own, as by ``python -m stripe_newton.isaaclab``, and ends after
``--steps`` turns of its loop; it must write its picture. ``--out`` keeps the outcomes, one JSON object a line, and a
later call goes on where it stopped. ``tools/documentation/isaaclab_table.py`` makes a table of them.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from isaaclab_runs import in_process

import stripe_newton.isaaclab as dialect
from stripe_newton.isaaclab.__main__ import run_script
from stripe_newton.isaaclab.app import PICTURE, STOP_AFTER

PARTS = ("tutorials", "demos")
"""Folders of the scripts."""
NUM_ENVS = "--num_envs"
"""Option of scripts for the number of environments, which is passed to those that have it."""


@dataclass
class Outcome:
    """One script: whether it runs."""

    script: str
    """Its path below the folder of the scripts."""
    runs: str
    """``"ok"``, or why it does not run."""


def scripts_in(folder: Path) -> list[str]:
    """Names of the scripts in a folder, relative to it."""
    return [str(file.relative_to(folder)) for part in PARTS for file in sorted((folder / part).rglob("*.py"))]


def picture_of(script: str, folder: Path) -> Path:
    """File of a script's picture."""
    return folder / (Path(script).with_suffix("").as_posix().replace("/", "_") + ".png")


def run_one(folder: Path, script: str, picture: Path, steps: int, num_envs: int) -> None:
    """Run a script.

    Raises:
        RuntimeError: it wrote no picture.
    """
    os.environ[STOP_AFTER], os.environ[PICTURE] = str(steps), str(picture)
    file = folder / script
    arguments = ["--headless", "--device", "cpu"]
    if NUM_ENVS in file.read_text():
        arguments += [NUM_ENVS, str(num_envs)]
    try:
        run_script(str(file), arguments)
    except SystemExit as end:
        if end.code not in (None, 0):
            raise
    if not picture.is_file():
        raise RuntimeError("it ended without a picture")


def run_all(folder: Path, scripts: list[str], pictures: Path, steps: int, num_envs: int) -> Iterator[Outcome]:
    """Run scripts one after the other."""
    for script in scripts:
        picture = picture_of(script, pictures)
        picture.unlink(missing_ok=True)
        yield Outcome(script, in_process(run_one, folder, script, picture, steps, num_envs))


def kept_outcomes(file: Path | None) -> list[Outcome]:
    """The latest outcome of each script that ``--out`` has written to a file; none where there is no file yet."""
    if file is None or not file.exists():
        return []
    outcomes = [Outcome(**json.loads(line)) for line in file.read_text().splitlines()]
    return list({outcome.script: outcome for outcome in outcomes}.values())


def main() -> int:
    """Run the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="SCRIPTS")
    parser.add_argument("scripts", nargs="*", metavar="NAME")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--num-envs", type=int, default=4)
    parser.add_argument("--pictures", type=Path, default=Path(tempfile.gettempdir()) / "isaaclab_scripts")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if not (scripts := scripts_in(args.folder)):
        parser.error("give SCRIPTS, the folder that holds tutorials/ and demos/")
    if unknown := [name for name in args.scripts if name not in scripts]:
        parser.error(f"no such script: {', '.join(unknown)}")
    args.pictures.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    dialect.install()
    done = {outcome.script for outcome in kept_outcomes(args.out)}
    wanted = [script for script in args.scripts or scripts if script not in done]
    failed = 0
    for outcome in run_all(args.folder, wanted, args.pictures, args.steps, args.num_envs):
        failed += outcome.runs != "ok"
        print(f"{outcome.script}  {outcome.runs}", flush=True)
        if args.out is not None:
            with args.out.open("a") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
