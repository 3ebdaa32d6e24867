# SPDX-License-Identifier: Apache-2.0
"""Terms."""

from stripe_kernels.mdp import *  # noqa: F403
