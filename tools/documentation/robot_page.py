# SPDX-License-Identifier: Apache-2.0
"""Robot page: write the table of docs/robots.md, the robots by name with their poses and drives, from ``ROBOTS``.

python tools/documentation/robot_page.py
"""

from __future__ import annotations

from pathlib import Path

from stripe_newton.assets import ROBOTS
from stripe_newton.assets.robot_table import Drive, RobotEntry

__all__ = ["PAGE", "table", "with_table"]

PAGE = Path(__file__).parents[2] / "docs" / "robots.md"
HEAD = "| name | robot | base | pose [m, rad] | drives: joints, stiffness, damping, largest effort |"


def table() -> list[str]:
    """Lines of the table."""
    rows = [f"| `{name}` | {entry.title} | {_base(entry)} | {_pose(entry)} | {_drives(entry)} |"
            for name, entry in ROBOTS.items()]  # fmt: skip
    return [HEAD, "| --- | --- | --- | --- | --- |", *rows]


def with_table(page: str) -> str:
    """The page with the table in place of the one that it has."""
    before, _, rest = page.partition(HEAD)
    after = rest[rest.index("\n\n") :]
    return before + "\n".join(table()) + after


def _base(entry: RobotEntry) -> str:
    height = f"{entry.pos[2]:g}"
    return f"held at {height}" if entry.fixed_base else f"floats from {height}" if not entry.keyframe else "floats"


def _pose(entry: RobotEntry) -> str:
    if entry.keyframe:
        return f"keyframe `{entry.keyframe}`"
    joints = [f"{_code(name)} {value:.4g}" for name, value in entry.joint_pos.items()]
    return "; ".join(joints) or "the file's"


def _drives(entry: RobotEntry) -> str:
    return "; ".join(_drive(drive) for drive in entry.drives.values()) or "the file's"


def _drive(drive: Drive) -> str:
    effort = "" if drive.effort is None else f", {drive.effort:g}"
    return f"{_code(drive.joints)} {drive.stiffness:g}, {drive.damping:g}{effort}"


def _code(expression: str) -> str:
    """An expression in a cell of a table, where a bar would end the cell."""
    return "`" + expression.replace("|", "\\|") + "`"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text()))
