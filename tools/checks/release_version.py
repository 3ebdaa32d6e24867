# SPDX-License-Identifier: Apache-2.0
"""Release version: checks that a tag is the version of pyproject.toml, and that the changelog has a section of it.

python tools/checks/release_version.py v0.2.0
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def problems(tag: str, pyproject: str, changelog: str) -> list[str]:
    """What is wrong with a release, a line each.

    Args:
        tag: The tag, such as ``v0.2.0``.
        pyproject: Text of ``pyproject.toml``.
        changelog: Text of ``CHANGELOG.md``.
    """
    found = re.search(r'^version = "([^"]+)"$', pyproject, re.M)
    version = found[1] if found else "(none)"
    wrong = []
    if tag != f"v{version}":
        wrong.append(f"the tag is {tag}, pyproject.toml has version {version}: tag v{version}, or change the version")
    if not re.search(rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$", changelog, re.M):
        wrong.append(f"CHANGELOG.md: has no heading '## [{version}] - DATE'")
    return wrong


def main() -> int:
    texts = ((ROOT / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "CHANGELOG.md"))
    wrong = problems(sys.argv[1], *texts)
    print("\n".join(wrong) or f"{sys.argv[1]} can be released")
    return len(wrong) > 0


if __name__ == "__main__":
    sys.exit(main())
