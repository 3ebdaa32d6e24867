# SPDX-License-Identifier: Apache-2.0
"""Case: one wrong input, how it is tried, how it ended; and the judgement of an error message."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

__all__ = ["BAD", "OUTCOMES", "Case", "judge_message", "table"]

OUTCOMES = ("works", "clear", "unclear", "traceback", "crash", "hang", "silent")
"""``works``: the input turned out to be right. ``clear``: one message that names what is wrong. ``unclear``: one that
does not. ``traceback``: an error that nobody raised on purpose. ``crash`` also counts memory without bound. ``silent``:
a wrong input was taken, or something was written or run that must not be."""
BAD = ("traceback", "crash", "hang", "silent", "broken")
"""Outcomes that must not be."""
MOST_LINES = 40
"""Lines of a message that a reader still reads."""


@dataclass
class Case:
    """One wrong input."""

    group: str
    """Row of the table."""
    kind: str
    """How it is tried: ``config``, ``command``, ``call`` or ``process``."""
    what: str
    """The input in words."""
    data: dict[str, Any]
    """What the trial needs, as JSON."""
    names: list[str] = field(default_factory=list)
    """Words one of which is in a clear message: the field, the option, the file."""
    may_pass: bool = False
    """Whether the input may turn out to be right."""
    outcome: str = ""
    text: str = ""
    seconds: float = 0.0


def judge_message(text: str, names: list[str]) -> str:
    """Whether an error message is clear: short, without a traceback, and with one of the names in it."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text)
    # The boxes in which tyro prints errors break long words.
    joined = re.sub(r"[│\s]+", "", plain).replace("_", "-").lower()
    if "Traceback (most recent call last)" in plain:
        return "traceback"
    named = not names or any(re.sub(r"\s+", "", name).replace("_", "-").lower() in joined for name in names)
    lines = [line for line in plain.splitlines() if line.strip()]
    return "clear" if named and lines and len(lines) <= MOST_LINES else "unclear"


def table(cases: list[Case]) -> str:
    """The outcomes by group, in Markdown."""
    cases = [case for case in cases if case.outcome]  # a run may be ended early
    groups = sorted({case.group for case in cases})
    rows = [(group, [case.outcome for case in cases if case.group == group]) for group in groups]
    rows.append(("all", [case.outcome for case in cases]))
    lines = [f"| class | tried | {' | '.join(OUTCOMES)} |", "|---|" + "---:|" * (1 + len(OUTCOMES))]
    for group, found in rows:
        lines.append(f"| {group} | {len(found)} | {' | '.join(str(found.count(name)) for name in OUTCOMES)} |")
    return "\n".join(lines) + "\n"
