# SPDX-License-Identifier: Apache-2.0
"""llms.txt of the docs site: its pages with one line each, and all of their Markdown in one file, for programs."""

from __future__ import annotations

import re
from pathlib import Path

from .site_pages import read_navigation

__all__ = ["write_llms"]

_SUMMARY = "Training environments for robots on the Newton physics engine: a USD scene in, a trained policy out."
_LINK = re.compile(r"\[([^\[\]]*)\]\([^)\s]+\)")


def write_llms(root: Path, pages: Path, site: Path) -> None:
    """Write ``llms.txt`` and ``llms-full.txt`` (https://llmstxt.org), and the Markdown of each page beside its HTML.

    Args:
        root: The project.
        pages: Folder of the copied pages.
        site: Folder of the built site.
    """
    short, full = [f"# stripe-newton\n\n> {_SUMMARY}\n"], []
    for caption, names in read_navigation(root):
        short.append(f"\n## {caption}\n")
        for name in names:
            page = pages / f"{name}.md"
            if name.startswith("reference/"):  # made of docstrings
                short.append(f"- [API reference]({name}.html): classes and functions by package")
                continue
            text = page.read_text(encoding="utf-8")
            (site / f"{name}.md").write_text(text, encoding="utf-8")
            short.append(f"- [{title_of(text)}]({name}.md): {summary_of(text)}")
            full.append(f"<!-- {name}.md -->\n\n{text.strip()}\n")
    (site / "llms.txt").write_text("\n".join(short) + "\n", encoding="utf-8")
    (site / "llms-full.txt").write_text("\n".join(full), encoding="utf-8")


def title_of(text: str) -> str:
    """The first heading of a page."""
    found = re.search(r"^# (.*)$", text, re.M)
    return found[1] if found else ""


def summary_of(text: str) -> str:
    """The first sentence of a page, without links."""
    body = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    for paragraph in re.split(r"\n\s*\n", body):
        if paragraph.strip() and not paragraph.startswith(("#", "!", "|", "-", "<", "[!", "    ")):
            plain = _LINK.sub(r"\1", " ".join(paragraph.split()))
            return re.split(r"(?<=\.)\s", plain)[0].rstrip(":")
    return title_of(text)
