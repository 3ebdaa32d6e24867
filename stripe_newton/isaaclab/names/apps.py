# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Sim's own modules, and of Isaac Lab's application."""

from .entries import Table

NAMES: dict[str, Table] = {
    "isaacsim": {},
    "omni": {},
    "carb": {},
}

ALIASES: dict[str, str] = {}
