# SPDX-License-Identifier: Apache-2.0
"""Robot file error: everything that keeps a URDF or MJCF file from being simulated as it is written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["RobotFileError"]

_SHOWN = 12
"""Most problems that the message lists: a script that writes files makes the same mistake everywhere."""


class RobotFileError(ValueError):
    """A robot's file that is refused.

    Attributes:
        path: The file.
        problems: Each as ``element: what is wrong, what would be right``.
    """

    def __init__(self, path: str | Path, problems: Sequence[str]):
        self.path, self.problems = Path(path), list(problems)
        lines = self.problems[:_SHOWN]
        if len(self.problems) > _SHOWN:
            lines.append(f"and {len(self.problems) - _SHOWN} more")
        text = lines[0] if len(lines) == 1 else "".join(f"\n  {line}" for line in lines)
        super().__init__(f"'{path}': {text}")
