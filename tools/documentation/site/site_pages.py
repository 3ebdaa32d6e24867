# SPDX-License-Identifier: Apache-2.0
"""Pages of the docs site: the pages of ``docs/`` and of the project's root, copied to a folder that Sphinx builds."""

from __future__ import annotations

import posixpath
import re
import shutil
from pathlib import Path

import yaml

__all__ = ["PROJECT_PAGES", "copy_pages", "read_navigation", "write_contents"]

PROJECT_PAGES = {"README.md": "readme", "CHANGELOG.md": "changelog", "CONTRIBUTING.md": "contributing"}
"""Pages in the root of the project, and their names in the site's folder ``project``."""

_SIDEBAR_TITLES = {"project/readme": "Set-up and first environment"}
"""Titles in the sidebar of pages whose own heading says too little there."""

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*)\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^```.*?^```", re.S | re.M)


def read_navigation(root: Path) -> list[tuple[str, list[str]]]:
    """Captions and their pages, without endings, in the order of the site."""
    data = yaml.safe_load((root / "docs" / "site" / "navigation.yaml").read_text(encoding="utf-8"))
    return [(part["caption"], list(part["pages"])) for part in data]


def copy_pages(root: Path, target: Path) -> None:
    """Copy the pages, pictures and Sphinx's files. Links that leave ``docs/`` lead to the copies, or become text."""
    shutil.copytree(root / "docs" / "site", target, dirs_exist_ok=True)
    shutil.copytree(root / "docs" / "images", target / "images", dirs_exist_ok=True)
    for page in sorted((root / "docs").glob("*.md")):
        text = rewrite_links(page.read_text(encoding="utf-8"), root, f"docs/{page.name}", page.name)
        (target / page.name).write_text(text, encoding="utf-8")
    (target / "project").mkdir()
    for source, name in PROJECT_PAGES.items():
        text = rewrite_links((root / source).read_text(encoding="utf-8"), root, source, f"project/{name}.md")
        (target / "project" / f"{name}.md").write_text(text, encoding="utf-8")


def rewrite_links(text: str, root: Path, source: str, place: str) -> str:
    """A page whose links fit its place in the site.

    Args:
        text: The page.
        root: The project.
        source: The page's path in the project.
        place: Its path in the site.
    """

    def replaced(match: re.Match) -> str:
        picture, words, link = match.groups()
        if not picture:
            words = _LINK.sub(replaced, words)  # a picture that is a link
        target, hash_sign, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link) or not target:
            return f"{picture}[{words}]({link})"
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        there = _place_of(path, root)
        if there is None:
            return words
        relative = posixpath.relpath(there, posixpath.dirname(place) or ".")
        return f"{picture}[{words}]({relative}{hash_sign}{anchor})"

    parts, end = [], 0
    for fence in _FENCE.finditer(text):
        parts += [_LINK.sub(replaced, text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, _LINK.sub(replaced, text[end:])])


def _place_of(path: str, root: Path) -> str | None:
    """Path in the site of a file of the project, or None if the site does not have it."""
    if path in PROJECT_PAGES:
        return f"project/{PROJECT_PAGES[path]}.md"
    if path == "SECURITY.md":
        return "security.md"
    inside = path.removeprefix("docs/")
    is_page = path.startswith("docs/") and (root / path).is_file() and inside.endswith((".md", ".png", ".jpg", ".svg"))
    return inside if is_page else None


def write_contents(root: Path, target: Path) -> None:
    """Write the root page, which has the navigation alone, and lets the start page be ``index.html``."""
    parts = ["stripe-newton", "=============", "", ".. toctree::", "   :hidden:", "", "   Home <index>", ""]
    for caption, pages in read_navigation(root):
        parts += [".. toctree::", "   :hidden:", f"   :caption: {caption}", ""]
        parts += [f"   {f'{_SIDEBAR_TITLES[p]} <{p}>' if p in _SIDEBAR_TITLES else p}" for p in pages] + [""]
    (target / "contents.rst").write_text("\n".join(parts), encoding="utf-8")
