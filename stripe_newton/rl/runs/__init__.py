# SPDX-License-Identifier: Apache-2.0
"""A training run on disk: its folder, checkpoints, log, videos, and the state that a resumed run needs."""
