# SPDX-License-Identifier: Apache-2.0
"""Export of a trained policy for use without this framework."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import warnings
from pathlib import Path

from .runner import OnPolicyRunner

__all__ = ["export_policy"]


def export_policy(runner: OnPolicyRunner, folder: str | os.PathLike) -> tuple[Path, Path]:
    """Write ``policy.pt`` (TorchScript) and ``policy.onnx`` into ``folder``.

    Both take the observation groups of the actor joined in the order of ``obs_groups["actor"]``, shape (1, n), float32,
    normalize them if the policy does, and return the actions without noise, shape (1, num_actions).

    Returns:
        The two files.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    exporter_log = logging.getLogger("torch.onnx")
    level = exporter_log.level
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")  # deprecations inside torch's own exporters
        exporter_log.setLevel(logging.ERROR)
        try:
            runner.export_policy_to_jit(str(folder), "policy.pt")
            runner.export_policy_to_onnx(str(folder), "policy.onnx")
        finally:
            exporter_log.setLevel(level)
    _into_one_file(folder / "policy.onnx")
    return folder / "policy.pt", folder / "policy.onnx"


def _into_one_file(path: Path) -> None:
    """Put the weights, which torch's exporter leaves in a second file, into the model."""
    import onnx

    model = onnx.load(str(path))
    onnx.save_model(model, str(path), save_as_external_data=False)
    path.with_name(path.name + ".data").unlink(missing_ok=True)
