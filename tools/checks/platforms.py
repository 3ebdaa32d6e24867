# SPDX-License-Identifier: Apache-2.0
"""Platforms: checks that every dependency has a wheel for each platform, by uv's resolver and the index's metadata.

python tools/checks/platforms.py [--uv uv] [--python 3.10 3.13]

Nothing is installed and no wheel is downloaded. It needs uv and an index.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PLATFORMS = {
    "Linux on x86_64, glibc 2.28": ("x86_64-manylinux_2_28", ""),
    "Linux on Arm, glibc 2.34": ("aarch64-manylinux_2_34", ""),
    "macOS 14 on Arm": ("aarch64-apple-darwin", "14.0"),
}
"""uv's names of the platforms, and the version of macOS. The oldest that Warp's and PyAV's wheels are made for."""


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--uv", default="uv", help="the program")
    parser.add_argument("--python", nargs="+", default=["3.10", "3.13"], help="versions of Python")
    args = parser.parse_args(argv)
    if shutil.which(args.uv) is None:
        parser.error(f"--uv: there is no program '{args.uv}'; 'pip install uv' installs it")
    failed = False
    for name, (platform, macos) in PLATFORMS.items():
        for version in args.python:
            count, error = resolve(args.uv, platform, macos, version)
            print(f"{name:<30} Python {version:<5} {error if error else f'{count} packages'}", flush=True)
            failed |= bool(error)
    return failed


def resolve(uv: str, platform: str, macos: str, python: str) -> tuple[int, str]:
    """Resolve the dependencies for a platform with wheels alone: their number, and an error, empty if there is none."""
    command = [uv, "pip", "compile", "--quiet", "--no-header", "--no-annotate", str(ROOT / "pyproject.toml")]
    command += ["--extra", "viser", "--only-binary", ":all:", "--python-platform", platform, "--python-version", python]
    env = os.environ | ({"MACOSX_DEPLOYMENT_TARGET": macos} if macos else {})
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    return len(run.stdout.splitlines()), run.stderr.strip() if run.returncode else ""


if __name__ == "__main__":
    sys.exit(main())
