# SPDX-License-Identifier: Apache-2.0
"""Examples in docstrings, which the API reference shows: they give what they say."""

from __future__ import annotations

import doctest
import importlib

import gymnasium
import pytest

from tests.helpers.checkout import ROOT
from tools.checks.source_metrics import source_files

MODULES = [name for name, path in source_files(ROOT).items() if ">>> " in path.read_text(encoding="utf-8")]


@pytest.fixture
def same_tasks():
    """Forget the tasks that an example registers."""
    before = dict(gymnasium.registry)
    yield
    gymnasium.registry.clear()
    gymnasium.registry.update(before)


def test_there_are_examples():
    assert {"stripe_newton.configclass", "stripe_newton.math.rotations"} <= set(MODULES)


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name, same_tasks):
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.attempted > 0
    assert found.failed == 0
