# SPDX-License-Identifier: Apache-2.0
"""Warp functions and kernels of stripe-newton. The modules import nothing but Warp, Newton and MuJoCo Warp."""

__all__: list[str] = []
