# SPDX-License-Identifier: Apache-2.0
"""Errors of the training side that are the user's to mend."""

from __future__ import annotations

__all__ = ["CheckpointError"]


class CheckpointError(ValueError):
    """A checkpoint or run folder that is missing, damaged, foreign, or of another network."""
