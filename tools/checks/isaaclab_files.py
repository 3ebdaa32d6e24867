# SPDX-License-Identifier: Apache-2.0
"""Files of Isaac Lab under the dialect: imports every module of ``isaaclab_tasks``, and says which fail and why.

    python tools/checks/isaaclab_files.py SOURCE [--json]

``SOURCE`` is the folder that holds ``isaaclab_tasks/`` and ``isaaclab_assets/``. The exit status is 0 if at least
:data:`EXPECTED` modules import, agents' files not counted.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import logging
import sys
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType

import stripe_newton.isaaclab as dialect

EXPECTED = 290
"""Modules that must import."""


@dataclass
class Row:
    """One module: whether it imports."""

    module: str
    """Name of the module."""
    is_agent: bool
    """Whether it is a file of an agent, below a folder ``agents``."""
    error: str | None
    """Why it does not import, or ``None``."""


def module_names(folder: Path) -> list[str]:
    """Names of all modules of a package, those of a folder after the folder itself."""
    names = []
    for file in sorted(folder.rglob("*.py")):
        parts = file.relative_to(folder.parent).with_suffix("").parts
        names.append(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return sorted(names)


def import_all(source: Path) -> list[Row]:
    """Import every module of ``isaaclab_tasks`` below ``source``, in one process, under the dialect."""
    for package in ("isaaclab_tasks", "isaaclab_assets"):
        if not (source / package / package / "__init__.py").is_file():
            raise SystemExit(
                f"error: no package {package} in {source / package}; give the folder 'source' of Isaac Lab"
            )
        sys.path.insert(0, str(source / package))
    dialect.install()
    folder = source / "isaaclab_tasks" / "isaaclab_tasks"
    # The package's own file imports all others and stops at the first that fails: it is imported last.
    _stand_for(folder)
    names = module_names(folder)
    rows = [_row(name) for name in names if name != folder.name]
    del sys.modules[folder.name]
    return [_row(folder.name), *rows]


def _stand_for(folder: Path) -> None:
    """Put an empty package in the place of the one in ``folder``, so that its modules are found."""
    package = ModuleType(folder.name)
    package.__path__ = [str(folder)]
    sys.modules[folder.name] = package


def _row(module: str) -> Row:
    error = None
    try:
        importlib.import_module(module)
    except (Exception, SystemExit) as failure:
        error = " ".join(f"{type(failure).__name__}: {failure}".split())[:300]
    return Row(module, ".agents" in module, error)


def main() -> int:
    """Run the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--json", action="store_true", help="print a JSON list, one object for each module")
    args = parser.parse_args()
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    rows = import_all(args.source.resolve())
    if args.json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
    else:
        for row in rows:
            print(f"{row.module}  {row.error or 'imports'}")
    counts = {kind: [row.error is None for row in rows if row.is_agent == kind] for kind in (False, True)}
    print(
        f"{sum(counts[False])} of {len(counts[False])} modules import, and {sum(counts[True])} of "
        f"{len(counts[True])} files of agents",
        file=sys.stderr,
    )
    return 0 if sum(counts[False]) >= EXPECTED else 1


if __name__ == "__main__":
    sys.exit(main())
