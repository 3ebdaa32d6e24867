# SPDX-License-Identifier: Apache-2.0
"""BoundedSession: runs an ONNX network of somebody else's by onnxruntime, within bounded time.

A small file may stand for a loop without end, or for products of large matrices.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from stripe_newton.rl.errors import CheckpointError

if TYPE_CHECKING:
    import onnxruntime

__all__ = ["BoundedSession"]

LONGEST_S = 30.0
"""Longest time that a network may take for the actions of all environments [s]."""
_LOOKS_S = 1.0
"""Time between two looks at how long it takes [s]."""


class BoundedSession:
    """An ONNX network.

    Args:
        path: The file.
        device: Device of the environment; the network runs on a GPU if onnxruntime can.

    Raises:
        CheckpointError: if onnxruntime is missing, or cannot run the file.
    """

    def __init__(self, path: Path, device: str):
        try:
            import onnxruntime
        except ImportError:
            raise CheckpointError(
                f"{path}: an ONNX file needs onnxruntime: pip install stripe-newton[export]"
            ) from None
        there = onnxruntime.get_available_providers()
        wanted = ["CUDAExecutionProvider"] if device.startswith("cuda") else []
        providers = [p for p in [*wanted, "CPUExecutionProvider"] if p in there]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()  # by default one for each core, busy or not
        self._path, self._began = path, 0.0
        self._run_options = onnxruntime.RunOptions()
        try:
            # Without what computes constants here, where nothing can end it.
            self.network: onnxruntime.InferenceSession = onnxruntime.InferenceSession(
                str(path), options, providers=providers, disabled_optimizers=["ConstantFolding"]
            )
        except Exception as error:  # its errors have no common base
            raise CheckpointError(f"{path}: onnxruntime cannot run it ({_first_line(error)})") from None
        # A thread that lives as long as this object, since one for each step would take longer than the network.
        threading.Thread(target=_watch, args=(weakref.ref(self),), name="bounded_session", daemon=True).start()

    def run(self, names: Sequence[str], inputs: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """The outputs of some names.

        Raises:
            CheckpointError: if the network takes too long, or more memory than there is.
        """
        self._began = time.monotonic()
        try:
            outputs: list[np.ndarray] = self.network.run(list(names), dict(inputs), self._run_options)
        except Exception as error:
            if self._run_options.terminate:
                reason = f"its network takes more than {LONGEST_S:g} s for a step; use fewer environments"
                raise CheckpointError(f"{self._path}: {reason}") from None
            raise CheckpointError(f"{self._path}: onnxruntime cannot run it ({_first_line(error)})") from None
        finally:
            self._began = 0.0
        return outputs

    def end_if_late(self) -> None:
        """Let onnxruntime end what has been running for too long, after the operator that it is at."""
        if self._began and time.monotonic() - self._began > LONGEST_S:
            self._run_options.terminate = True


def _watch(of: weakref.ref[BoundedSession]) -> None:
    while (session := of()) is not None:
        session.end_if_late()
        del session  # or it would live for ever
        time.sleep(_LOOKS_S)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]
