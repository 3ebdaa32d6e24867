# SPDX-License-Identifier: Apache-2.0
"""Importer warnings: those of Newton, collected as rows of a report, each once with its number."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from stripe_newton.usd.newton_warnings import collected_warnings

from .urdf_checks import Row

__all__ = ["warnings_as_rows"]


@contextmanager
def warnings_as_rows(rows: list[Row]) -> Iterator[None]:
    """Collect the warnings of Newton, from ``warnings`` and from its log, as rows.

    Warnings that differ in a name in quotes alone, as those of the geoms of a robot do, make one row.
    """
    with collected_warnings() as texts:
        yield
    alike: dict[str, Counter[str]] = {}
    for text in texts:
        alike.setdefault(re.sub(r"'[^']*'", "'...'", text), Counter())[text] += 1
    for found in alike.values():
        first, total = next(iter(found)), found.total()
        names = re.findall(r"'([^']*)'", first)
        where = names[0] if names else ""
        rows.append((f"{where} (+{total - 1} more)" if total > 1 else where, "warning of Newton", first))
