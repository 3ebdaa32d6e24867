# SPDX-License-Identifier: Apache-2.0
"""Builds the docs site: ``python -m tools.documentation.site.build_site OUT``.

OUT/VERSION is the site of this version, OUT/versions.json the list of all versions in OUT, and OUT/index.html leads to
the newest. A warning of Sphinx is an error. Nothing is loaded from the network, neither by the build nor by the pages.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tools.documentation.site.site_llms import write_llms
from tools.documentation.site.site_pages import copy_pages, write_contents
from tools.documentation.site.site_reference import write_reference
from tools.documentation.site.versions import write_versions

ROOT = Path(__file__).resolve().parents[3]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of the sites of all versions")
    parser.add_argument("--version", default=own_version(), help="name of this version, such as 'dev'")
    args = parser.parse_args(argv)
    site = args.out / args.version
    with tempfile.TemporaryDirectory() as folder:
        pages = Path(folder, "pages")
        copy_pages(ROOT, pages)
        write_contents(ROOT, pages)
        write_reference(pages)
        code = run_sphinx(pages, site, Path(folder, "cache"), args.version)
        if code:
            return code
        write_llms(ROOT, pages, site)
    write_versions(args.out)
    print(site / "index.html")
    return 0


def own_version() -> str:
    """The version in ``pyproject.toml``."""
    found = re.search(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    assert found
    return found[1]


def run_sphinx(pages: Path, site: Path, cache: Path, version: str) -> int:
    """Run Sphinx in a process of its own, with warnings as errors."""
    env = os.environ | {"STRIPE_NEWTON_ROOT": str(ROOT), "STRIPE_NEWTON_VERSION": version}
    words = ["-q", "-W", "--keep-going", "-j", "auto", "-b", "html", "-d", str(cache), str(pages), str(site)]
    return subprocess.run([sys.executable, "-m", "sphinx", *words], env=env, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
