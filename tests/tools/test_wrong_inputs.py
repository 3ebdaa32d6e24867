# SPDX-License-Identifier: Apache-2.0
"""Wrong inputs: a share of those that the generator makes of a fixed seed; none may end in a way that must not be."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from tests.helpers.checkout import PYTHONPATH, ROOT

TOOL = ROOT / "tools" / "checks" / "wrong_inputs" / "try_inputs.py"


@pytest.mark.slow
def test_no_wrong_input_ends_badly(tmp_path):
    command = [sys.executable, str(TOOL), str(tmp_path), "--count", "300", "--seed", "7"]
    environment = os.environ | {"PYTHONPATH": PYTHONPATH}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    record = json.loads((tmp_path / "record.json").read_text())
    bad = [case for case in record if case["outcome"] in ("traceback", "crash", "hang", "silent", "broken", "")]
    assert not bad, done.stdout
    assert done.returncode == 0
    assert len(record) > 250
    odd = {"forms of YAML", "expressions", "data in stages", "odd folders", "other tasks"}
    assert odd <= {case["group"] for case in record}
    assert sum(case["outcome"] == "clear" for case in record) > 150
