# SPDX-License-Identifier: Apache-2.0
"""UserError: a command line that asks for something that is not there or not possible."""

from __future__ import annotations

__all__ = ["UserError"]


class UserError(Exception):
    """Shown as one message without a traceback; the command ends with exit code 2."""
