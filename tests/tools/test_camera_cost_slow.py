# SPDX-License-Identifier: Apache-2.0
"""The benchmark of cameras on the CPU: its parts and rates."""

from __future__ import annotations

import json

import pytest

from tools.benchmarks import camera_cost

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("case", "parts"), [("cart-poles", {"shading", "shadows", "observation"}), ("quadrupeds", set())]
)
def test_the_cost_of_a_picture_by_part(case, parts, tmp_path, monkeypatch, capsys):
    out = tmp_path / "found.json"
    options = ["--case", case, "--num-envs", "4", "--steps", "2", "--size", "16", "12", "--device", "cpu"]
    monkeypatch.setattr("sys.argv", ["camera_cost.py", *options, "--newton", "--out", str(out)])
    camera_cost.main()
    found = json.loads(out.read_text())
    assert json.loads(capsys.readouterr().out) == found
    assert {"step", "camera", "place", "rays", "writing", "newton_plane", "newton_refit", *parts} <= found["ms"].keys()
    assert "16 x 12" in found["camera"]
    assert all(value > 0.0 for name, value in found["ms"].items() if name.startswith(("all_", "newton_", "step")))
    assert found["pictures_per_s"]["camera"] == pytest.approx(4000.0 / found["ms"]["camera"], rel=0.05)
