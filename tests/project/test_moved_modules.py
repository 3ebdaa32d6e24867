# SPDX-License-Identifier: Apache-2.0
"""Old module paths: they warn, and give the module at its new path."""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys

import pytest

from stripe_newton import moved_modules
from tests.helpers.checkout import ROOT


@pytest.fixture
def moved(tmp_path, monkeypatch):
    """A package ``tidy`` whose ``tidy.new`` was ``tidy.old`` once."""
    folder = tmp_path / "tidy"
    (folder / "new").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "new" / "__init__.py").write_text("from .thing import Thing\n")
    (folder / "new" / "thing.py").write_text("class Thing:\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(moved_modules, "MOVED", {})
    moved_modules.forward_modules({"tidy.old": "tidy.new"})
    yield
    for name in [n for n in sys.modules if n.partition(".")[0] == "tidy"]:
        del sys.modules[name]


def test_the_old_path_warns_and_names_the_new_one(moved):
    with pytest.warns(DeprecationWarning, match=r"'tidy\.old' has moved to 'tidy\.new'"):
        old = importlib.import_module("tidy.old")
    new = importlib.import_module("tidy.new")
    assert old is new
    assert new.__spec__.name == "tidy.new"


def test_what_stands_below_an_old_path_is_the_same_class(moved):
    with pytest.warns(DeprecationWarning, match=r"'tidy\.old\.thing' has moved to 'tidy\.new\.thing'"):
        from tidy.old.thing import Thing
    from tidy.new import Thing as SameThing

    assert Thing is SameThing


def test_other_names_are_not_found(moved):
    with pytest.raises(ModuleNotFoundError, match=r"tidy\.older"):
        importlib.import_module("tidy.older")


def test_all_old_paths_lead_to_modules():
    import stripe_tasks  # noqa: F401  (it adds its own)

    for new in set(moved_modules.MOVED.values()):
        assert importlib.util.find_spec(new) is not None, new


def test_the_changelog_lists_each_old_path():
    import stripe_tasks  # noqa: F401

    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    listed = set()
    for entry in re.findall(r"^- `(stripe_\w+(?:\.\w+)*)`.*?:((?:.|\n  )*)", text, re.MULTILINE):
        listed |= {f"{entry[0]}.{old}" for old in re.findall(r"`(\w+)` →", entry[1])}
    assert not moved_modules.MOVED.keys() - listed
