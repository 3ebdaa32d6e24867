# SPDX-License-Identifier: Apache-2.0
"""HTML page: one file without links to others, for comparisons and reports of runs, in light and dark."""

from __future__ import annotations

import html
from collections.abc import Sequence

__all__ = ["COLORS", "html_document", "html_table"]

COLORS = (
    ("#2f6fb5", "#6aa9ee"),
    ("#d1600a", "#f59a4d"),
    ("#2a8a55", "#5cc98d"),
    ("#9c3fa8", "#d288dd"),
    ("#b8322f", "#f07f78"),
    ("#7a6a14", "#d3bd4a"),
    ("#11808c", "#53c3cf"),
    ("#5b5f6b", "#b3b8c4"),
)
"""Colour of each group or run on a light and on a dark page; it is the variable ``--group-N`` of the page."""

_STYLE = """
:root { color-scheme: light dark; --back: #ffffff; --card: #f6f7f9; --text: #24292f; --soft: #5b6470; --grid: #dfe3e8;
  LIGHT }
@media (prefers-color-scheme: dark) { :root { --back: #14171c; --card: #1c2027; --text: #dde2e8; --soft: #98a2ae;
  --grid: #343b45; DARK } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1.2rem clamp(.8rem, 3vw, 2rem) 3rem; background: var(--back);
  color: var(--text); font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
h1 { font-size: 1.35rem; margin: .2rem 0; } h2 { font-size: 1.08rem; margin: 2rem 0 .6rem; }
p { margin: .3rem 0; color: var(--soft); }
.legend { display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; margin: .9rem 0; padding: 0; list-style: none; }
.key { display: inline-block; width: 1.3em; height: .3em; border-radius: 2px; margin-right: .45em;
  vertical-align: middle; }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 21rem), 1fr)); gap: 1rem; }
figure { margin: 0; padding: .7rem .8rem .4rem; background: var(--card); border-radius: 10px; min-width: 0; }
figcaption { font-weight: 600; overflow-wrap: anywhere; } figure svg { display: block; width: 100%; height: auto; }
.scroll { overflow-x: auto; background: var(--card); border-radius: 10px; padding: .3rem .2rem; }
table { border-collapse: collapse; width: 100%; font-size: .93em; }
th, td { padding: .38rem .75rem; text-align: right; white-space: nowrap; border-top: 1px solid var(--grid); }
thead th { border-top: 0; color: var(--soft); font-weight: 600; }
th:first-child, td:first-child { text-align: left; white-space: normal; min-width: 9rem; }
td { font-variant-numeric: tabular-nums; } .best { font-weight: 700; }
.fields td, .fields th { text-align: left; }
.fields td { white-space: normal; overflow-wrap: anywhere; min-width: 6rem; }
.fields td:first-child, li code { font-family: ui-monospace, SFMono-Regular, Menlo, monospace; font-size: .88em; }
.fields td:first-child { min-width: 12rem; } .note { border-left: 3px solid var(--group-1); padding-left: .7rem; }
@media (max-width: 36rem) { table { font-size: .84em; } th, td { padding: .35rem .45rem; } th { white-space: normal; }
  th:first-child, td:first-child { min-width: 6.5rem; } }
details { margin-top: 2rem; } summary { cursor: pointer; font-weight: 600; } li { overflow-wrap: anywhere; }
"""


def html_document(title: str, sections: Sequence[str], style: str = "", head: str = "") -> str:
    """A page that adapts to the width of the screen and to a dark theme.

    Args:
        title: The title, as plain text.
        sections: Parts of the body, as HTML.
        style: Rules of CSS beside those of all pages.
        head: Further elements of the head, as HTML.
    """
    # Colours are variables of the page, which the charts use too, so that one rule switches all of them to dark.
    light, dark = (" ".join(f"--group-{at}: {pair[mode]};" for at, pair in enumerate(COLORS)) for mode in (0, 1))
    rules = _STYLE.replace("LIGHT", light).replace("DARK", dark) + style
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"{head}<title>{html.escape(title)}</title>\n<style>{rules}</style>\n</head>\n<body>\n"
        + "\n".join(sections)
        + "\n</body>\n</html>\n"
    )


def html_table(head: Sequence[str], rows: Sequence[tuple[Sequence[str], bool]], kind: str = "") -> str:
    """A table of cells that are HTML already; a row may be marked as the best."""
    body = ""
    for cells, best in rows:
        body += f"<tr{' class=best' if best else ''}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    top = "".join(f"<th>{name}</th>" for name in head)
    return f'<div class="scroll"><table class="{kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
