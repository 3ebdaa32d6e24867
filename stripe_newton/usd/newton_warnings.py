# SPDX-License-Identifier: Apache-2.0
"""Newton's warnings: collected while an importer runs, for the rows of a report."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["collected_warnings"]


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Collect Newton's warnings, from ``warnings`` and from its log, in a list that is filled at the end."""
    texts: list[str] = []
    handler, logger = _TextHandler(), logging.getLogger("newton")
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")  # Python shows a warning once; each report needs it
            yield texts
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    texts += [str(w.message) for w in caught if not issubclass(w.category, (ImportWarning, ResourceWarning))]
    texts += handler.texts


class _TextHandler(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())
