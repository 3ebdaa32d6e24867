# SPDX-License-Identifier: Apache-2.0
"""Rules of the test files: folders mirror the packages, helpers hold no tests, GPU and slow files are named so."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.helpers.checkout import ROOT

TESTS = ROOT / "tests"
FILES = sorted(TESTS.rglob("test_*.py"))
OTHER_FOLDERS = {"benchmarks", "designs", "helpers", "kernels", "project", "tasks", "tools"}
"""Folders that mirror no subpackage of ``stripe_newton``."""
MARKS = ("gpu", "slow")


def marks_of_all_tests(path: Path) -> set[str]:
    """Marks that ``pytestmark`` gives to all tests of a file."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            return {mark for mark in MARKS if f"pytest.mark.{mark}" in ast.unparse(node.value)}
    return set()


def test_folders_mirror_the_packages():
    folders = {path.name for path in TESTS.iterdir() if any(path.rglob("*.py"))}
    assert folders <= OTHER_FOLDERS | {path.name for path in (ROOT / "stripe_newton").iterdir()} | {"specifications"}


def test_helpers_hold_no_tests():
    assert not list((TESTS / "helpers").rglob("test_*.py"))
    for path in (TESTS / "helpers").rglob("*.py"):
        functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)]
        assert not [node.name for node in functions if node.name.startswith("test_")], path


def test_no_test_file_imports_another_one():
    for path in FILES:
        imported = [
            node.module or "" for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)
        ]
        assert not [name for name in imported if name.startswith("tests.") and ".test_" in name], path


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_files_of_gpu_or_slow_tests_alone_end_so(path):
    named = {mark for mark in MARKS if path.stem.endswith(f"_{mark}")}
    assert named == marks_of_all_tests(path)
