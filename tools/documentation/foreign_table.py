# SPDX-License-Identifier: Apache-2.0
"""Foreign table: the part of docs/stages.md on files of other projects; see ``stage_table.py``."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "checks"))

from file_worker import Answer, try_files

__all__ = ["HEADING", "foreign_section", "try_foreign_files"]

HEADING = "# Files of other projects"
LIST = Path(__file__).parent / "foreign_files.txt"
_HEAD = "| file | outcome | bodies | joints | shapes | rows | acc. | path | whole hulls | reason |"
_AT_RANDOM = (
    "Of 283 files drawn at random from copies of 43 projects, some of which are in the tables, 209 stepped, 73 were "
    "refused, 32 of them as parts were missing from the copies, and one diverged and said so. None ended in a "
    "traceback, a crash or a hang, or was another model after a round trip."
)
_SAME, _ALIKE = 1e-4, 1e-3
"""Difference below which a model is the same but for single precision, and its hulls but for theirs."""
TRIAL = Path(__file__).parents[1] / "checks" / "file_trial.py"


def listed_files() -> list[tuple[str, str]]:
    """Source and path of each file of the list: a line ``[source]`` holds for the paths after it."""
    source, found = "", []
    for line in LIST.read_text().splitlines():
        if line.startswith("["):
            source = line.strip("[]")
        elif line:
            found.append((source, line))
    return found


def try_foreign_files(folders: dict[str, Path], record: Path, timeout: float, workers: int = 2) -> None:
    """Try the files whose source has a folder here and that the record does not have; add them to the record.

    Args:
        folders: Folder by source.
        record: A file with a line of JSON for each file that was tried.
        timeout: Seconds that a file may take.
        workers: Processes at a time.
    """
    known = {(row["source"], row["file"]) for row in _read(record)}
    files = [pair for pair in listed_files() if pair[0] in folders and pair not in known]

    def tell(index: int, answer: Answer) -> None:
        source, file = files[index]
        facts = dict(answer.facts)
        facts["rows"] = len(facts.get("rows", ()))
        text = answer.text.strip().splitlines()[-1] if answer.text else ""
        row = {"source": source, "file": file, "outcome": answer.outcome, "facts": facts}
        row["reason"] = _reason(text, folders[source] / file)
        with record.open("a") as stream:
            stream.write(json.dumps(row) + "\n")
        print(f"{answer.outcome:9} {source} {file} {row['reason']}", flush=True)

    paths = [str(folders[source] / file) for source, file in files]
    try_files(paths, [sys.executable, str(TRIAL)], workers, timeout, tell)


def _reason(text: str, path: Path) -> str:
    """A reason without the folders of this machine."""
    text = re.sub(r"^(MJCF|URDF) file at '[^']*': ", "", text).replace(f"'{path}'", path.name)
    text = text.replace(str(path), path.name)
    for folder in path.parents[:-1]:
        text = text.replace(f"{folder}/", "")
    return text.removeprefix(f"{path.name}: ").removeprefix("/: ")


def foreign_section(record: Path, page: str) -> list[str]:
    """Lines of the section, of the files of the list that the record has, or else the page so far.

    Args:
        record: What :func:`try_foreign_files` found.
        page: The section as it is.
    """
    rows = _rows_of(page) | {(row["source"], row["file"]): _line(row) for row in _read(record)}
    found = {pair: rows[pair] for pair in listed_files() if pair in rows}
    cells = [[cell.strip() for cell in line.split(" | ")] for line in found.values()]
    steps = sum(row[1] == "steps" for row in cells)
    compared = [float(row[6]) for row in cells if row[6]]
    close = sum(acceleration < _SAME for acceleration in compared)
    whole = [float(row[8].split(",")[0]) for row in cells if row[8]]
    closer = sum(acceleration < _ALIKE for acceleration in whole)
    lines = [
        HEADING,
        "",
        f"{len(found)} USD, URDF and MJCF files of other projects, each loaded as a scene of one environment with its "
        "own gravity, exported, opened again, and stepped 200 times (1/240 s; an MJCF file by its own time step) on "
        f"the CPU. {steps} step: the state is finite after each step, and the exported scene is the same model to the "
        "last bit. *refused* gives the line that the user sees; *diverges* is what a step said. The root of a URDF "
        "file that does not say whether it floats is held. *rows* are those of the report: what was left out, read "
        "differently or changed.",
        "",
        f"MJCF files are compared with MuJoCo's own C library in double precision, {len(compared)} of them: *acc.* is "
        "the largest difference of an acceleration in 20 random states within the joint limits, relative to the "
        "largest of the state, *path* that of a coordinate over 200 steps with the same random controls [rad, m]. "
        f"Below {_SAME:.0e} the model is the same but for single precision, as of {close}; a path is longer than that "
        "where contacts begin, which multiply rounding. The others have rows that say what differs, such as hinges "
        "with several anchors, tendons over them, collisions with a parent that is fixed, inverse weights at a `ref`, "
        "contact margins beside a box, damping of free joints, or hulls of more than 64 corners. Equal moments of "
        "inertia in a medium are set apart by a hundredth of a per cent (`activation.xml`: 1e-3 where boxes are deep "
        "in each other). The solver's meshes have their centre in the middle of the surface, not of the volume as in "
        "the file: where hulls are deep in each other the search for contacts starts there and may find others "
        '(`g1_dual_arm.xml`: 7e-2, and 3e-5 from a file with `inertia="shell"` for its meshes). *whole hulls* are '
        f"both numbers with `max_hull_vertices=-1`, of the {len(whole)} files with such a row: {closer} of them are "
        f"then within {_ALIKE:.0e}. Time step, integrator and flags of the solver are the file's in both, as a scene "
        "has settings of its own; and drives with a "
        "`forcerange` are limited as `MuJoCoSolverCfg(drive_limits=True)` does.",
        "",
        _AT_RANDOM,
        "",
        "`python tools/documentation/stage_table.py --foreign RECORD --source NAME=FOLDER ...` writes this section; "
        "`tools/documentation/foreign_files.txt` lists the files.",
    ]
    for source in dict.fromkeys(source for source, _ in found):
        lines += ["", f"## {source}", "", _HEAD, "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |"]
        lines += [line for (of, _), line in found.items() if of == source]
    return [*lines, ""]


def _rows_of(page: str) -> dict[tuple[str, str], str]:
    """Rows of the page by source and file."""
    source, found = "", {}
    for line in page.splitlines():
        if line.startswith("## "):
            source = line[3:]
        elif line.startswith("| `"):
            found[source, line.split("`")[1]] = line
    return found


def _line(row: dict[str, Any]) -> str:
    facts, mujoco = row["facts"], row["facts"].get("mujoco")
    numbers = [str(facts.get(name, "")) for name in ("bodies", "joints", "shapes")]
    numbers.append(str(facts["rows"]) if numbers[0] else "")
    reason = row["reason"]
    if mujoco and mujoco["why_not"]:
        reason = reason or f"not compared: {mujoco['why_not']}"
    differences = (
        [f"{mujoco[n]:.0e}" for n in ("acceleration", "at_end")] if mujoco and not mujoco["why_not"] else ["", ""]
    )
    whole = facts.get("mujoco_whole_hulls")
    hulls = f"{whole['acceleration']:.0e}, {whole['at_end']:.0e}" if whole and not whole["why_not"] else ""
    cells = [f"`{row['file']}`", row["outcome"], *numbers, *differences, hulls, reason[:300].replace("|", "\\|")]
    return f"| {' | '.join(cells)} |"


def _read(record: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
