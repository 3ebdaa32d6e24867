# SPDX-License-Identifier: Apache-2.0
"""CUDA calls: ``.cuda()`` of tensors and modules has no effect under the dialect where there is no GPU.

Isaac Lab needs a GPU, and its walkthrough moves tensors there by name. Without one their place is the CPU.
"""

from __future__ import annotations

import functools
import logging
from typing import TypeVar

import torch

__all__ = ["ignore_cuda_calls", "restore_cuda_calls"]

_log = logging.getLogger(__name__)
_MODULE_CUDA = torch.nn.Module.cuda
_T = TypeVar("_T")


def ignore_cuda_calls() -> None:
    """Let ``.cuda()`` give the tensor or module itself, until :func:`restore_cuda_calls`, if there is no GPU."""
    if not torch.cuda.is_available():
        torch.Tensor.cuda = _stay  # type: ignore[method-assign, assignment]
        torch.nn.Module.cuda = _stay  # type: ignore[method-assign]


def restore_cuda_calls() -> None:
    """Let ``.cuda()`` be torch's own again."""
    if "cuda" in vars(torch.Tensor):  # torch's own is that of its base class
        del torch.Tensor.cuda
        torch.nn.Module.cuda = _MODULE_CUDA  # type: ignore[method-assign]


def _stay(self: _T, *args: object, **kwargs: object) -> _T:
    _tell()
    return self


@functools.cache
def _tell() -> None:
    """Say so once in a process."""
    _log.warning("'.cuda()' has no effect: there is no GPU, tensors stay on the CPU")
