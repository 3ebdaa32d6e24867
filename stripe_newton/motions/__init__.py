# SPDX-License-Identifier: Apache-2.0
"""Motions: recordings of how a robot moves, from the files in which they are published, for robots that track them."""

from .library import MotionLibrary
from .motion import Motion, MotionError
from .readers import find_motions, read_motion

__all__ = ["Motion", "MotionError", "MotionLibrary", "find_motions", "read_motion"]
