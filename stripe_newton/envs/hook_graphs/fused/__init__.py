# SPDX-License-Identifier: Apache-2.0
"""Fused hooks: chains of torch operations on the rows of environments, each chain as one kernel."""

from .fusing_mode import NotFusible
from .hook_fusion import HookFusion

__all__ = ["HookFusion", "NotFusible"]
