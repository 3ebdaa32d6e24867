# SPDX-License-Identifier: Apache-2.0
"""Errors of the training side that are the user's to mend."""

from __future__ import annotations

__all__ = ["CheckpointError", "CheckpointWriteError", "ExportError"]


class CheckpointError(ValueError):
    """A checkpoint or run folder that is missing, damaged, foreign, or of another network."""


class CheckpointWriteError(CheckpointError):
    """A checkpoint that could not be written; what was there before is untouched."""


class ExportError(RuntimeError):
    """A network that cannot be exported, or an exported policy that does not act as the network does."""
