# SPDX-License-Identifier: Apache-2.0
"""A forest to walk in, and scenes made of its parts."""

from .scenes import ClearingSpec, ForestSpec, PathSpec, RavineSpec

__all__ = ["ClearingSpec", "ForestSpec", "PathSpec", "RavineSpec"]
