# SPDX-License-Identifier: Apache-2.0
"""Warp functions and kernels of stripe-newton. Each module imports Warp (and Newton's types) alone."""

__all__: list[str] = []
