# SPDX-License-Identifier: Apache-2.0
"""Generated files: source code of kernels beside the kernel cache, where Warp reads it back and a user can read it."""

from __future__ import annotations

import os
from pathlib import Path

import warp as wp

__all__ = ["write_generated"]


def write_generated(name: str, text: str) -> Path:
    """Write a file atomically, as other processes may write the same one at the same time.

    Args:
        name: Its name, which has a hash of the text: a file that is there is not written again.
        text: Its contents.
    """
    wp.init()  # sets wp.config.kernel_cache_dir
    path = Path(wp.config.kernel_cache_dir) / "stripe_newton" / name
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_suffix(f".{os.getpid()}")
        draft.write_text(text)
        os.replace(draft, path)
    return path
