# SPDX-License-Identifier: Apache-2.0
"""Lock file: it has the dependencies and extras of pyproject.toml; after a change of those, run ``uv lock``."""

from __future__ import annotations

import re

from tests.helpers.checkout import ROOT

PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_lock_file_has_what_the_project_needs():
    """Names and extras; `uv lock --check`, in a slow test and in CI, compares versions."""
    lock = (ROOT / "uv.lock").read_text(encoding="utf-8")
    own = re.search(r'\[\[package\]\]\nname = "stripe-newton"\n.*?(?=\n\[\[package\]\]|\Z)', lock, re.S)[0]
    section = re.search(r"^dependencies = \[\n(.*?)^\]", PYPROJECT, re.S | re.M)[1]
    wanted = {re.split(r"[\[<>=~;, ]", name)[0].lower() for name in re.findall(r'^\s+"([^"]+)"', section, re.M)}
    assert len(wanted) > 15
    assert wanted <= set(re.findall(r'name = "([^"]+)"', own))
    extras = re.search(r"\[project.optional-dependencies\]\n(.*?)\n\n\[", PYPROJECT, re.S)[1]
    for extra in re.findall(r"^(\w+) = \[(?!\])", extras, re.M):
        assert re.search(rf"^{extra} = \[", own, re.M), f"uv.lock: lacks the extra '{extra}'; run uv lock"
