# SPDX-License-Identifier: Apache-2.0
"""Importer warnings: those of Newton, collected as rows of a report, each once with its number."""

from __future__ import annotations

import logging
import re
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from .urdf_checks import Row

__all__ = ["warnings_as_rows"]


@contextmanager
def warnings_as_rows(rows: list[Row]) -> Iterator[None]:
    """Collect the warnings of Newton, from ``warnings`` and from its log, as rows.

    Warnings that differ in a name in quotes alone, as those of the geoms of a robot do, make one row.
    """
    handler, logger = _TextHandler(), logging.getLogger("newton")
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    texts = [str(w.message) for w in caught if not issubclass(w.category, (ImportWarning, ResourceWarning))]
    alike: dict[str, Counter[str]] = {}
    for text in [*texts, *handler.texts]:
        alike.setdefault(re.sub(r"'[^']*'", "'...'", text), Counter())[text] += 1
    for found in alike.values():
        first, total = next(iter(found)), found.total()
        names = re.findall(r"'([^']*)'", first)
        where = names[0] if names else ""
        rows.append((f"{where} (+{total - 1} more)" if total > 1 else where, "warning of Newton", first))


class _TextHandler(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())
