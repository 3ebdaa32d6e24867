# SPDX-License-Identifier: Apache-2.0
"""Export of a trained policy: ONNX and TorchScript files, their check, their metadata, and a policy read from them."""

from __future__ import annotations

from .exporter import ExportedPolicy, export_policy

__all__ = ["ExportedPolicy", "export_policy"]
