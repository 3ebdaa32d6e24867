# SPDX-License-Identifier: Apache-2.0
"""Docs site: its navigation, links, versions and llms.txt; the slow test builds it with warnings as errors."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import types

import pytest

from tests.helpers.checkout import ROOT
from tools.documentation.site import site_llms, site_pages, site_reference, versions
from tools.pictures import concept_figures

PATH = os.pathsep.join(str(ROOT / part) for part in (".", "kernels", "tasks"))


def test_the_navigation_names_each_page_once():
    named = [page for _, pages in site_pages.read_navigation(ROOT) for page in pages]
    own = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    made = {f"project/{name}" for name in site_pages.PROJECT_PAGES.values()} | {"reference/index"}
    assert len(named) == len(set(named))
    assert set(named) == own | made


def test_the_start_page_leads_to_each_page():
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    own = {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert own <= set(re.findall(r"\]\(([a-z_]+\.md)", text))


@pytest.mark.parametrize(
    ("source", "place", "link", "expected"),
    [
        ("docs/step.md", "step.md", "[a](managers.md#the-log)", "[a](managers.md#the-log)"),
        ("docs/step.md", "step.md", "[a](../README.md#tasks)", "[a](project/readme.md#tasks)"),
        ("docs/step.md", "step.md", "[the data](../kernels/stripe_kernels/data.py)", "the data"),
        ("docs/step.md", "step.md", "[a](#resets), [b](https://x.org/y)", "[a](#resets), [b](https://x.org/y)"),
        ("README.md", "project/readme.md", "![p](docs/images/hero.jpg)", "![p](../images/hero.jpg)"),
        (
            "README.md",
            "project/readme.md",
            "[a](SECURITY.md) [b](CHANGELOG.md)",
            "[a](../security.md) [b](changelog.md)",
        ),
        ("README.md", "project/readme.md", "[a](LICENSE)", "a"),
        ("docs/step.md", "step.md", "```\n[a](../README.md)\n```", "```\n[a](../README.md)\n```"),
    ],
)
def test_links_fit_the_place_of_the_page(source, place, link, expected):
    assert site_pages.rewrite_links(link, ROOT, source, place) == expected


def test_links_of_the_copied_pages_lead_to_files(tmp_path):
    target = tmp_path / "pages"
    site_pages.copy_pages(ROOT, target)
    pages = sorted(target.rglob("*.md"))
    assert len(pages) == len(list((ROOT / "docs").glob("*.md"))) + 3
    for page in pages:
        for link in re.findall(r"\]\(([^)\s#]+)", site_pages._FENCE.sub("", page.read_text(encoding="utf-8"))):
            if not re.match(r"[a-z]+:", link) and link.endswith((".md", ".png", ".jpg", ".svg", ".py")):
                assert (page.parent / link).is_file(), f"{page.name}: {link}"


def test_llms_txt_names_each_page_with_a_sentence(tmp_path):
    pages, site = tmp_path / "pages", tmp_path / "site"
    site_pages.copy_pages(ROOT, pages)
    (site / "project").mkdir(parents=True)
    site_llms.write_llms(ROOT, pages, site)
    text = (site / "llms.txt").read_text(encoding="utf-8")
    assert text.startswith("# stripe-newton\n\n> ")
    entries = re.findall(r"^- \[(.+)\]\((\S+)\): (.+)$", text, re.M)
    assert {page for _, page, _ in entries} == {
        f"{name}.{'html' if name.startswith('reference/') else 'md'}"
        for _, names in site_pages.read_navigation(ROOT)
        for name in names
    }
    for _, page, sentence in entries:
        assert page.endswith(".html") or (site / page).is_file()
        assert not re.search(r"\]\(|^[#|!]", sentence)
    full = (site / "llms-full.txt").read_text(encoding="utf-8")
    assert full.count("<!-- ") >= len(entries) - 1
    assert len(full) > 300_000


def test_sentences_of_pages():
    text = "# Title\n\n![picture](a.png)\n\n| a | b |\n\nIt is [a page](b.md). More.\n"
    assert (site_llms.title_of(text), site_llms.summary_of(text)) == ("Title", "It is a page.")
    assert site_llms.summary_of("# Title\n\n```\ncode\n```\n") == "Title"


def test_versions_are_sorted_by_their_numbers(tmp_path):
    for name in ("0.9.0", "v0.10.0", "dev", "0.2.1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "contents.html").touch()
    (tmp_path / "other").mkdir()
    versions.write_versions(tmp_path)
    assert json.loads((tmp_path / "versions.json").read_text()) == ["v0.10.0", "0.9.0", "0.2.1", "dev"]
    assert "url=v0.10.0/index.html" in (tmp_path / "index.html").read_text()


def test_each_public_package_has_a_reference_page():
    """Packages that list public names, but for the command line; read rather than imported, which takes long."""
    folders = [path for path in (ROOT / "stripe_newton").iterdir() if (path / "__init__.py").is_file()]
    public = {f.name for f in folders if re.search(r"^__all__ = ", (f / "__init__.py").read_text(), re.M)}
    assert len(public) > 10
    assert {f"stripe_newton.{name}" for name in public - {"cli"}} <= {name for name, _ in site_reference.PACKAGES}


def test_the_reference_has_each_public_name():
    seen: dict[int, str] = {}
    module = importlib.import_module("stripe_newton.registration")
    text = site_reference._page(module, "Registration", seen)
    assert re.findall(r"autofunction:: (\S+)", text) == [f"{module.__name__}.{name}" for name in sorted(module.__all__)]
    # The second page of a name leads to the first.
    assert "``register_task``: :py:obj:`stripe_newton.registration.register_task`." in site_reference._page(
        types.SimpleNamespace(__name__="other", __all__=["register_task"], register_task=module.register_task),
        "O",
        seen,
    )


def test_a_term_stands_with_its_arguments_and_its_docstring():
    module = importlib.import_module("stripe_kernels.mdp.tracking")
    text = "\n".join(site_reference._entry(module, "track_lin_vel_xy_exp"))
    assert ".. py:function:: track_lin_vel_xy_exp(env, robot, command, std)" in text
    assert "exponential kernel" in text


def test_the_figures_of_the_concepts_are_as_drawn():
    for name, figure in concept_figures.draw().items():
        assert (ROOT / "docs" / "images" / name).read_text(encoding="utf-8") == figure


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("furo"), reason="needs stripe-newton[docs]")
def test_the_site_builds_without_warnings(tmp_path):
    command = [sys.executable, "-m", "tools.documentation.site.build_site", str(tmp_path / "site")]
    run = subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": PATH}, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    (site,) = (path.parent for path in (tmp_path / "site").glob("*/searchindex.js"))
    assert (site / "llms.txt").is_file()
    assert "track_lin_vel_xy_exp" in (site / "searchindex.js").read_text(encoding="utf-8")
    page = (site / "reference" / "configclass.html").read_text(encoding="utf-8")
    assert "to_dict" in page
    external = re.findall(r'(?:src|href)="(https?:[^"]+\.(?:js|css|woff2?))"', page)
    assert external == []
    shutil.rmtree(tmp_path / "site")
