# SPDX-License-Identifier: Apache-2.0
"""Collapsed buildings between streets, to walk in."""

from .scenes import RubbleSpec

__all__ = ["RubbleSpec"]
