# SPDX-License-Identifier: Apache-2.0
"""Forest: scenes of a procedural forest, and two tasks of a quadruped in it."""

from .scenes import ClearingSpec, ForestSpec, PathSpec, RavineSpec

__all__ = ["ClearingSpec", "ForestSpec", "PathSpec", "RavineSpec"]
