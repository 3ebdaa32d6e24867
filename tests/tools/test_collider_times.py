# SPDX-License-Identifier: Apache-2.0
"""Tool ``collider_times.py``: a row of a file with cylinders."""

from __future__ import annotations

import sys

import pytest

from stripe_newton.solvers import contact_pairs
from tests.helpers.checkout import TOOLS

sys.path.insert(0, str(TOOLS / "benchmarks"))

import collider_times as tool


@pytest.mark.slow  # compiles two kernels
def test_a_row(tmp_path, capsys):
    body = '<body pos="0 0 0.3"><freejoint/><geom type="cylinder" size="0.1 0.1"/></body>'
    (tmp_path / "cans.xml").write_text(f"<mujoco><worldbody>{body}{body}</worldbody></mujoco>")
    kinds = contact_pairs.KINDS
    tool.main([str(tmp_path / "cans.xml"), "--num-worlds", "2", "--steps", "3"])
    assert contact_pairs.KINDS is kinds
    row = capsys.readouterr().out.splitlines()[2].split(" | ")
    assert row[0].endswith("cans.xml`")
    assert all(float(text.strip(" |")) > 0.0 for text in row[1:])
