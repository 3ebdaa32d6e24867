# SPDX-License-Identifier: Apache-2.0
"""Config: the protocol of a config of any class made with ``@configclass``."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Config"]


class Config(Protocol):
    """A config of any class; ``@configclass`` adds these methods."""

    def to_dict(self) -> dict:
        """Nested dicts of plain values, fit for YAML."""

    def validate(self) -> None:
        """Check all fields.

        Raises:
            ConfigError: all problems.
        """
