# SPDX-License-Identifier: Apache-2.0
"""Tool ``fallback_table.py``: rows of robots, of files and of what cannot be loaded, and both tables."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.helpers.checkout import TOOLS
from tests.helpers.solver_models import leave_curved_pairs

sys.path.insert(0, str(TOOLS / "documentation"))

import fallback_table as tool

LINK = '<body name="{0}" pos="0 0 0.3"><joint name="joint_{0}" axis="0 1 0"/><geom type="{1}" size="0.1 0.1 0.1"/>'


def write_file(path: Path, shape: str) -> None:
    """A robot of three links, of which the first and the last may touch."""
    links = "".join(LINK.format(k, shape) for k in range(3))
    path.write_text(f"<mujoco><worldbody>{links}{'</body>' * 3}</worldbody></mujoco>")


def test_rows_of_robots_and_files(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tool, "task_ids", list)
    write_file(tmp_path / "links.xml", "sphere")
    write_file(tmp_path / "round.xml", "ellipsoid")
    leave_curved_pairs(monkeypatch)
    write_file(tmp_path / "scene.xml", "sphere")
    (tmp_path / "broken.xml").write_text("<mujoco>")
    tool.main(["--files", str(tmp_path), "--only", "cart-pole", ".xml"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[2] == "| cart-pole | 2 | one launch |"
    assert lines[3].startswith("| `broken.xml` |  | not loaded: ")
    assert lines[4:] == [
        "| `links.xml` | 3 | one launch |",
        "| `round.xml` | 3 | MuJoCo Warp's collision detection for ellipsoid and ellipsoid, plane and ellipsoid |",
    ]


def test_equal_rows_are_one_in_the_grouped_table():
    rows = [tool.Row("a", 2, "one launch"), tool.Row("b", None, "not loaded: x|y"), tool.Row("c", 3, "one launch", 1.5)]
    assert tool.grouped(rows)[2:] == ["| one launch | a (2), c (3) |", "| not loaded: x/y | b |"]
    assert tool.table(rows)[2:] == [
        "| a | 2 | one launch |  |",
        "| b |  | not loaded: x\\|y |  |",
        "| c | 3 | one launch | 1.5 |",
    ]
