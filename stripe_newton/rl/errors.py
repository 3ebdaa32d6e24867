# SPDX-License-Identifier: Apache-2.0
"""Errors of training that the user can fix: checkpoints, diverged policies and exports."""

from __future__ import annotations

__all__ = ["CheckpointError", "CheckpointWriteError", "DivergedError", "ExportError", "RanksError"]


class CheckpointError(ValueError):
    """A checkpoint or run folder that is missing, damaged, of another program, or of other networks."""


class CheckpointWriteError(CheckpointError):
    """A checkpoint that could not be written; the file that was there before is untouched."""


class DivergedError(RuntimeError):
    """A policy whose weights or losses are not finite any more."""


class ExportError(RuntimeError):
    """A network that cannot be exported, or an exported policy whose actions differ from the network's."""


class RanksError(ValueError):
    """Environment variables of a process among several that contradict each other, or are no numbers."""
