# SPDX-License-Identifier: Apache-2.0
"""Tools ``solver_scaling.py`` and ``solver_scaling_cases.py``: the robots, failures, table and picture."""

from __future__ import annotations

import json
import sys

import mujoco
import pytest
from PIL import Image

from tests.helpers.checkout import TOOLS

sys.path.insert(0, str(TOOLS / "benchmarks"))

import solver_scaling as tool
import solver_scaling_cases as cases

PROGRAM = """
import json, pathlib, sys
request = json.loads(pathlib.Path(sys.argv[1]).read_text())
pathlib.Path(request["ready"]).write_text("")
sys.stdin.readline()
found = [case | {"ms": 1.0, "rows": 16.0, "num_worlds": case["size"], "nv": 6 + 3 * case["size"], "device": "X"}
         for case in request["cases"] if case["size"] != 2]
pathlib.Path(request["out"]).write_text(json.dumps(found))
sys.exit(3)
"""


@pytest.mark.parametrize(("limbs", "spheres", "touching"), [(0, 4, 4), (4, 24, 8), (14, 4, 4)])
def test_a_robot_has_as_many_degrees_of_freedom_and_contacts_as_asked_for(limbs, spheres, touching):
    model = mujoco.MjModel.from_xml_string(cases.robot_mjcf(limbs, spheres, touching))
    data = mujoco.MjData(model)
    assert model.nv == 6 + cases.JOINTS * limbs
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert data.ncon == touching


def test_both_solvers_meet_the_same_rows():
    options = cases.Options("cpu", worlds=2, steps=1, blocks=1)
    found = [cases.build(cases.Case("rows", solver, 8), options).measure() for solver in tool.SOLVERS]
    assert [entry["nv"] for entry in found] == [18, 18]
    assert found[0]["rows"] == found[1]["rows"] > 16
    assert found[0]["physics"].startswith("the fused step")
    assert all(entry["ms"] > 0.0 and entry["finite"] for entry in found)


def test_a_failure_is_the_result_of_its_case(capsys):
    def fail() -> None:
        raise MemoryError("too large\nfor it")

    entries: dict[cases.Case, cases.Entry] = {}
    cases.attempt(cases.Case("rows", "fused", 4), entries, fail)
    assert list(entries.values()) == [{"error": "MemoryError: too large"}]


def test_few_worlds_share_a_process_and_many_come_first():
    found = tool.processes_of(["worlds", "dofs", "rows"], {"worlds": [1, 16, 4096], "dofs": [0, 2], "rows": [0, 4]})
    assert next(iter(found)) == "worlds_fused_4096"
    assert [case["size"] for case in found["worlds_fused_0"]] == [1, 16]
    assert {case["solver"] for case in found["dofs_2"]} == set(tool.SOLVERS)
    assert len(found["rows"]) == 4


def test_the_tool_goes_on_after_failures_and_draws(tmp_path, monkeypatch, capsys):
    program = tmp_path / "solver_scaling_cases.py"
    program.write_text(PROGRAM)
    monkeypatch.setattr(tool, "__file__", str(tmp_path / "solver_scaling.py"))
    out = tmp_path / "out"
    tool.main([str(out), "--parts", "worlds", "--sizes", "1", "2", "--device", "cpu"])
    tool.main([str(out), "--parts", "dofs", "--sizes", "4", "--device", "cpu"])
    entries = json.loads((out / "results.json").read_text())
    assert [(e["part"], e["size"], "error" in e) for e in entries[::2]] == [
        ("worlds", 1, False),
        ("worlds", 2, True),
        ("dofs", 4, False),
    ]
    text = (out / "results.md").read_text()
    assert "| 1 | 1.000 | 1.000 | 1.0 | 16.0 |" in text
    assert "| 18 | 1.000 | 1.000 | 1.0 | 16.0 |" in text
    assert "one kernel: the process ended with status 3" in text
    with Image.open(out / "solver_scaling.png") as picture:
        assert picture.size == (1500, 432)


def test_sizes_belong_to_one_part(capsys):
    with pytest.raises(SystemExit):
        tool.parse(["out", "--sizes", "1"])
    assert "--sizes: needs one part" in capsys.readouterr().err
