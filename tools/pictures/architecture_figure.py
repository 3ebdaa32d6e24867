# SPDX-License-Identifier: Apache-2.0
"""Architecture figure: draw docs/images/architecture.svg, the ways of an action, a term, a stage and a reset.

python tools/pictures/architecture_figure.py [--output docs/images/architecture.svg]
"""

from __future__ import annotations

import argparse
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[2]

Box = tuple[str, str, str]
"""Title, what happens, and the file, from the root of the repository."""

LANES: dict[str, tuple[str, list[Box]]] = {
    "An action": (
        "in every step",
        [
            ("env.step(action)", "checks and copies it in", "stripe_newton/envs/stepped_scene.py"),
            ("action terms", "scale and clip, set targets", "stripe_newton/managers/action_manager.py"),
            ("physics steps", "as many as decimation says", "stripe_newton/sim/simulation.py"),
            ("actuators", "targets become efforts", "stripe_newton/actuators/actuation.py"),
            ("the solver", "Newton's, on state and control", "stripe_newton/sim/solver_cfg.py"),
        ],
    ),
    "A reward term": (
        "when an environment is made",
        [
            ("its config entry", "function, weight, parameters", "stripe_newton/managers/reward_manager.py"),
            ("bind_term", "an array or number per argument", "stripe_newton/fusion/binding.py"),
            ("a section", "lines of source, and what they use", "stripe_newton/fusion/section.py"),
            ("a fused kernel", "sections of a stage together", "stripe_newton/fusion/kernel_source.py"),
            ("the plan", "kernels as one CUDA graph", "stripe_newton/fusion/plan.py"),
        ],
    ),
    "A stage": (
        "when a scene is made",
        [
            ("spawners", "write files, shapes into it", "stripe_newton/sim/spawners/from_files.py"),
            ("the scene", "its stage, in construction", "stripe_newton/scene/interactive_scene.py"),
            ("Newton's importer", "reads it; a report says what", "stripe_newton/usd/loading.py"),
            ("the builder", "one environment, replicated", "stripe_newton/scene/builder.py"),
            ("assets", "views of the state, structs", "stripe_newton/assets/articulation.py"),
        ],
    ),
    "A reset": (
        "in every step, where an episode ends",
        [
            ("terminations", "write one bit per environment", "stripe_newton/managers/termination_manager.py"),
            ("the reset mask", "indices once, if torch asks", "stripe_newton/sim/reset_mask.py"),
            ("reset events", "write joints, roots, targets", "stripe_newton/managers/event_manager.py"),
            ("safety", "masks of what has moved", "stripe_newton/envs/safety.py"),
            ("the simulation", "bodies follow, memory cleared", "stripe_newton/sim/simulation.py"),
        ],
    ),
}
WIDTH, HEIGHT, GAP, TOP, LANE = 232, 74, 22, 16, 128
COLORS = ("#2f6db5", "#b5622f", "#3d8b57", "#8a4fa3")
FONT = "font-family='Helvetica, Arial, sans-serif'"


def text(x: float, y: float, words: str, size: int, color: str = "#1c2733", weight: str = "normal") -> str:
    """A line of text; ``x`` is its left end."""
    return f"<text x='{x}' y='{y}' font-size='{size}' fill='{color}' font-weight='{weight}'>{escape(words)}</text>"


def box(x: float, y: float, content: Box, color: str) -> list[str]:
    """A station of a way."""
    title, what, file = content
    folder, _, name = file.removeprefix("stripe_newton/").rpartition("/")
    return [
        f"<rect x='{x}' y='{y}' width='{WIDTH}' height='{HEIGHT}' rx='6' fill='#ffffff' stroke='{color}' "
        "stroke-width='1.5'/>",
        text(x + 12, y + 23, title, 15, weight="bold"),
        text(x + 12, y + 42, what, 12),
        text(x + 12, y + 61, f"{folder}/{name}", 11, color),
    ]


def arrow(x: float, y: float, color: str) -> str:
    """An arrow from a box to the next one."""
    end = x + GAP - 3
    return (
        f"<path d='M{x + 2} {y} H{end} M{end - 6} {y - 5} L{end} {y} L{end - 6} {y + 5}' fill='none' stroke='{color}' "
        "stroke-width='1.5'/>"
    )


def draw() -> str:
    """The figure as SVG.

    Raises:
        FileNotFoundError: if a file that it names does not exist.
    """
    lines = []
    for row, ((name, (when, boxes)), color) in enumerate(zip(LANES.items(), COLORS, strict=True)):
        y = TOP + row * LANE
        lines += [text(GAP, y + 14, name, 16, color, "bold"), text(GAP + 150, y + 14, when, 12, "#5a6773")]
        for column, content in enumerate(boxes):
            if not (ROOT / content[2]).is_file():
                raise FileNotFoundError(f"{content[2]}, of '{content[0]}' in the figure, does not exist")
            x = GAP + column * (WIDTH + GAP)
            lines += box(x, y + 26, content, color)
            if column + 1 < len(boxes):
                lines.append(arrow(x + WIDTH, y + 26 + HEIGHT / 2, color))
    width, height = GAP + 5 * (WIDTH + GAP), TOP + len(LANES) * LANE
    head = (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' width='{width}' "
        f"height='{height}' {FONT}>"
    )
    background = f"<rect width='{width}' height='{height}' fill='#f6f8fa'/>"
    return "\n".join([head, background, *lines, "</svg>"]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images" / "architecture.svg")
    parser.parse_args().output.write_text(draw())


if __name__ == "__main__":
    main()
