# SPDX-License-Identifier: Apache-2.0
"""Concept figures: draw docs/images/concept_{step,term,stage}.svg, the ways of a step, a term and a stage.

python -m tools.pictures.concept_figures [--output docs/images]
"""

from __future__ import annotations

import argparse
from html import escape
from pathlib import Path

from tools.pictures.architecture_figure import FONT, text

ROOT = Path(__file__).parents[2]

Box = tuple[str, str, str]
"""Title, and two lines below it."""

BOX_WIDTH, BOX_HEIGHT, GAP, MARGIN = 196, 78, 34, 20
STEP: list[list[Box]] = [
    [
        ("policy", "a network: from observations", "to actions"),
        ("actions", "scaled to targets", "for the joints"),
        ("physics", "decimation times: motors,", "contacts, motion"),
        ("outcome", "which episodes end,", "what the step was worth"),
    ],
    [
        ("observations", "what the policy sees,", "noise and history added"),
        ("sensors", "contacts, rays, cameras,", "of the state as it is now"),
        ("commands", "goals drawn anew", "where their time is over"),
        ("reset", "ended episodes begin anew,", "in their own environment"),
    ],
]
"""The step: the first row from left to right, then the second from right to left, and round again."""
TERM: list[Box] = [
    ("a function", "upright(env, robot)", "computes one environment"),
    ("an entry of the config", "func, weight, params", "what people tune"),
    ("its manager", "finds each argument:", "data, numbers, structs"),
    ("one kernel", "written for all terms,", "runs for all environments"),
    ("one graph", "kernels of the whole step,", "launched as one"),
]
STAGE: list[Box] = [
    ("files", "USD, URDF, MJCF,", "or shapes from Python"),
    ("a stage", "one environment,", "and what all share"),
    ("a report", "what was read,", "what was ignored and why"),
    ("a model", "the environment copied,", "thousands of worlds"),
    ("views", "joint_pos, body_pose ...:", "the memory of the physics"),
]
COLORS = {"step": "#2f6db5", "term": "#b5622f", "stage": "#3d8b57"}


def box(x: float, y: float, content: Box, color: str) -> list[str]:
    """A station, with its title and what happens there."""
    title, first, second = content
    return [
        f"<rect x='{x}' y='{y}' width='{BOX_WIDTH}' height='{BOX_HEIGHT}' rx='7' fill='#ffffff' stroke='{color}' "
        "stroke-width='1.5'/>",
        text(x + 12, y + 25, title, 15, color, "bold"),
        text(x + 12, y + 46, first, 12.5),
        text(x + 12, y + 64, second, 12.5),
    ]


def arrow(start: tuple[float, float], end: tuple[float, float], color: str) -> str:
    """A straight arrow along one axis."""
    (x, y), (to_x, to_y) = start, end
    along_x, along_y = (to_x > x) - (to_x < x), (to_y > y) - (to_y < y)
    # The two strokes of the tip, turned with the arrow.
    tip = [(to_x - 6 * along_x - 5 * side * along_y, to_y - 6 * along_y - 5 * side * along_x) for side in (-1, 1)]
    lines = f"M{x} {y} L{to_x} {to_y} M{tip[0][0]} {tip[0][1]} L{to_x} {to_y} L{tip[1][0]} {tip[1][1]}"
    return f"<path d='{lines}' fill='none' stroke='{color}' stroke-width='1.6'/>"


def svg(width: float, height: float, title: str, lines: list[str]) -> str:
    """A picture on a pale ground, which is legible on a dark page, too."""
    return "\n".join(
        [
            f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' height='{height}' "
            f"role='img' {FONT}>",
            f"<title>{escape(title)}</title>",
            f"<rect width='{width}' height='{height}' rx='10' fill='#f6f8fa'/>",
            *lines,
            "</svg>\n",
        ]
    )


def row_figure(name: str, title: str, boxes: list[Box]) -> str:
    """Stations in a row, each with an arrow to the next."""
    color, y, lines = COLORS[name], MARGIN, []
    for number, content in enumerate(boxes):
        x = MARGIN + number * (BOX_WIDTH + GAP)
        lines += box(x, y, content, color)
        if number:
            middle = y + BOX_HEIGHT / 2
            lines.append(arrow((x - GAP + 4, middle), (x - 4, middle), color))
    return svg(2 * MARGIN + len(boxes) * (BOX_WIDTH + GAP) - GAP, 2 * MARGIN + BOX_HEIGHT, title, lines)


def step_figure() -> str:
    """The stations of a step as a loop of two rows."""
    color, lines = COLORS["step"], []
    top, bottom, last = MARGIN, MARGIN + BOX_HEIGHT + GAP, len(STEP[0]) - 1
    for row, y in enumerate((top, bottom)):
        for number, content in enumerate(STEP[row]):
            x = MARGIN + number * (BOX_WIDTH + GAP)
            lines += box(x, y, content, color)
            if number:
                ends = [(x - GAP + 4, y + BOX_HEIGHT / 2), (x - 4, y + BOX_HEIGHT / 2)]
                start, end = ends if row == 0 else ends[::-1]
                lines.append(arrow(start, end, color))
    down = MARGIN + last * (BOX_WIDTH + GAP) + BOX_WIDTH / 2
    up = MARGIN + BOX_WIDTH / 2
    lines.append(arrow((down, top + BOX_HEIGHT + 4), (down, bottom - 4), color))
    lines.append(arrow((up, bottom - 4), (up, top + BOX_HEIGHT + 4), color))
    width = 2 * MARGIN + len(STEP[0]) * (BOX_WIDTH + GAP) - GAP
    return svg(width, bottom + BOX_HEIGHT + MARGIN, "A step of all environments", lines)


def draw() -> dict[str, str]:
    """The figures by the names of their files."""
    return {
        "concept_step.svg": step_figure(),
        "concept_term.svg": row_figure("term", "The way of a term", TERM),
        "concept_stage.svg": row_figure("stage", "The way of a stage", STAGE),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images")
    folder = parser.parse_args().output
    for name, figure in draw().items():
        (folder / name).write_text(figure, encoding="utf-8")


if __name__ == "__main__":
    main()
