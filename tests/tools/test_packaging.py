# SPDX-License-Identifier: Apache-2.0
"""Packaging: version, lock file, workflows and sources fit together; slow tests build, resolve and run the notebook."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

from tests.helpers.checkout import PYTHONPATH, ROOT
from tools.checks import clean_install, platforms
from tools.checks.release_version import problems

NOTEBOOK = ROOT / "docs" / "notebooks" / "first_steps.ipynb"
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
SOURCES = [
    p for part in ("stripe_newton", "kernels", "tasks") for p in (ROOT / part).rglob("*") if p.suffix in (".py", ".h")
]


def test_the_version_stands_in_one_place():
    version = re.search(r'^version = "(.*)"$', PYPROJECT, re.M)[1]
    assert importlib.metadata.version("stripe-newton") == version
    assert not [p for p in SOURCES if re.search(r"^__version__ = [\"']\d", p.read_text(encoding="utf-8"), re.M)]


def test_a_release_needs_its_tag_and_its_changelog():
    project, log = 'version = "0.2.0"\n', "## [0.2.0] - 2026-01-31\n"
    assert problems("v0.2.0", project, log) == []
    assert "tag v0.2.0" in problems("v0.3.0", project, log)[0]
    assert "CHANGELOG.md" in problems("v0.2.0", project, "## [Unreleased]\n")[0]


def test_no_source_assumes_a_processor():
    words = re.compile(r"x86_64|amd64|immintrin|__SSE|__AVX|_mm\d*_")
    assert [str(p) for p in SOURCES if words.search(p.read_text(encoding="utf-8"))] == []


@pytest.mark.parametrize("file", sorted((ROOT / ".github" / "workflows").glob("*.yml")), ids=lambda p: p.name)
def test_workflows_name_files_and_targets_that_exist(file):
    text = file.read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    assert all(job["runs-on"] and job["steps"] for job in jobs.values())
    for name in re.findall(r"\b(?:tools|tests)/[\w/]+(?:\.py)?", text):
        assert (ROOT / name).exists(), name
    for module in re.findall(r"python -m (tools[\w.]+)", text):
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), module
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"run: make ([a-z]+)", text)) <= set(targets)


def test_the_container_file_copies_no_more_than_the_project():
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    assert "USER 1000" in text  # by number, so that a cluster sees that it is not root
    assert ".git" in (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    ignored = set((ROOT / ".dockerignore").read_text(encoding="utf-8").split())
    assert not ignored & {"stripe_newton", "kernels", "tasks", "README.md", "LICENSE", "pyproject.toml"}


def test_a_wheel_with_other_files_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(
        clean_install, "tracked_files", lambda: {"stripe_newton/a.py", "tasks/stripe_tasks/b.py", "c.md"}
    )
    for names, is_right in (
        (["stripe_newton/a.py", "stripe_tasks/b.py"], True),
        (["stripe_newton/a.py"], False),
        (["stripe_newton/a.py", "stripe_tasks/b.py", "tests/c.py"], False),
    ):
        wheel = tmp_path / "a.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in [*names, "x-1.dist-info/METADATA"]:
                archive.writestr(name, "")
        if is_right:
            clean_install.check_wheel(wheel)
        else:
            with pytest.raises(clean_install.InstallError, match="lacks, or has too much"):
                clean_install.check_wheel(wheel)


# -- the notebook


def cells() -> list[str]:
    """Its cells of Python; lines for the shell begin with ``!`` or ``%``."""
    content = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    return ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == "code"]


def test_the_notebook_is_small_and_its_python_compiles():
    assert NOTEBOOK.stat().st_size < 150_000
    own = [re.sub(r"^(\s*)[!%].*$", r"\1pass", cell, flags=re.M) for cell in cells()]
    for number, cell in enumerate(own):
        compile(cell, f"cell {number + 1}", "exec")
    assert "pip install" in cells()[0]


@pytest.mark.slow
def test_the_cells_of_the_notebook_run(tmp_path):
    """As a program, with less training; IPython's display is left to where there is one."""
    small = [re.sub(r"^(\s*)[!%].*$", r"\1pass", cell, flags=re.M) for cell in cells()]
    text = "\n".join(small).replace("max_iterations = 60", "max_iterations = 2")
    (tmp_path / "notebook.py").write_text(text, encoding="utf-8")
    env = os.environ | {"PYTHONPATH": PYTHONPATH}
    run = subprocess.run([sys.executable, "notebook.py"], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert list(tmp_path.glob("logs/*/*/report.html"))


# -- with tools that need not be there


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("build"), reason="needs the package build")
def test_the_distributions_have_the_files_of_the_repository(tmp_path):
    clean_install.check_wheel(clean_install.build(tmp_path / "dist", {}))


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("uv"), reason="needs uv")
def test_the_lock_file_is_as_uv_writes_it_and_all_platforms_have_wheels(tmp_path):
    for name in ("pyproject.toml", "uv.lock", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    subprocess.run(["uv", "lock", "--check"], cwd=tmp_path, check=True)
    for platform, macos in platforms.PLATFORMS.values():
        count, error = platforms.resolve("uv", platform, macos, "3.12")
        assert not error
        assert count > 50


def test_platforms_are_named_as_the_readme_does():
    text = Path(ROOT / "README.md").read_text(encoding="utf-8")
    assert "macOS 14" in text
    assert "glibc 2.34" in text
