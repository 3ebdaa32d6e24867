# SPDX-License-Identifier: Apache-2.0
"""``python -m stripe_newton.cli`` is ``stripe-newton``."""

from __future__ import annotations

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
