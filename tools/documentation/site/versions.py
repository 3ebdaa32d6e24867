# SPDX-License-Identifier: Apache-2.0
"""Versions of the docs site: the list that its pages offer, and the page that leads to the newest."""

from __future__ import annotations

import json
import re
from pathlib import Path

__all__ = ["version_key", "write_versions"]


def write_versions(out: Path) -> None:
    """Write the list of versions, newest first, and the page that leads to the newest."""
    versions = sorted((path.parent.name for path in out.glob("*/contents.html")), key=version_key, reverse=True)
    (out / "versions.json").write_text(json.dumps(versions), encoding="utf-8")
    newest = next((name for name in versions if re.match(r"v?\d", name)), versions[0])
    (out / "index.html").write_text(
        '<!DOCTYPE html><meta charset="utf-8"><title>stripe-newton</title>'
        f'<meta http-equiv="refresh" content="0; url={newest}/index.html"><a href="{newest}/index.html">{newest}</a>\n',
        encoding="utf-8",
    )


def version_key(name: str) -> tuple[bool, list[int]]:
    """Sorts versions by their numbers; names without numbers, as of a branch, come after all versions."""
    return bool(re.match(r"v?\d", name)), [int(number) for number in re.findall(r"\d+", name)]
