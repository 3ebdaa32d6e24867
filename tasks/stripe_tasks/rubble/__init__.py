# SPDX-License-Identifier: Apache-2.0
"""Rubble: scenes of collapsed buildings between streets."""

from .scenes import RubbleSpec

__all__ = ["RubbleSpec"]
