# SPDX-License-Identifier: Apache-2.0
"""Script runner of the Isaac Lab dialect: ``python -m stripe_newton.isaaclab SCRIPT [ARGUMENT ...]``."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from stripe_newton import isaaclab

__all__ = ["run_script"]


def run_script(script: str, arguments: list[str]) -> None:
    """Run a script as ``python SCRIPT ARGUMENT ...`` does, under the dialect.

    Raises:
        SystemExit: there is no such file, or the script ends so.
    """
    if not Path(script).is_file():
        raise SystemExit(f"error: no script '{script}'")
    isaaclab.install()
    sys.argv = [script, *arguments]
    sys.path.insert(0, str(Path(script).resolve().parent))
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit("usage: python -m stripe_newton.isaaclab SCRIPT [ARGUMENT ...]")
    run_script(sys.argv[1], sys.argv[2:])
