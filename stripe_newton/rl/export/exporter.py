# SPDX-License-Identifier: Apache-2.0
"""Exporter of a trained policy: ONNX, TorchScript and metadata, for use without this package."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from rsl_rl.models import CNNModel, MLPModel

from stripe_newton.rl.errors import ExportError

from .metadata_format import CheckInfo, PolicyMetadata
from .plain_network import OPSET, plain_onnx
from .policy_check import TOLERANCE, check_policy
from .policy_metadata import METADATA_FILE, describe_policy

if TYPE_CHECKING:
    import onnx

    from stripe_newton.rl.runner import OnPolicyRunner

__all__ = ["ExportedPolicy", "export_policy"]


@dataclass
class ExportedPolicy:
    """The files of an exported policy."""

    onnx: Path
    """``policy.onnx``, with the weights inside; it takes any number of environments."""
    torchscript: Path
    """``policy.pt``. A recurrent one keeps its own state, of one environment, and has ``reset()``."""
    json: Path
    """``policy.json``, the metadata, which both others have too."""
    metadata: PolicyMetadata
    """The metadata, as :func:`read_policy_metadata` reads them."""

    def __str__(self) -> str:
        lines = [f"{path}  {path.stat().st_size:,} bytes" for path in (self.onnx, self.torchscript, self.json)]
        check = self.metadata["check"]
        for name, found in check["results"].items() if check is not None else ():
            if found["largest_difference"] is None:
                lines.append(f"{name}: not checked, {found['by']}")
            else:
                number = found["largest_difference"]
                lines.append(f"{name}: at most {number:.2g} from the policy's actions ({found['by']})")
        return "\n".join(lines)


def export_policy(
    runner: OnPolicyRunner, folder: str | os.PathLike, *, task: str | None = None, run: str | None = None
) -> ExportedPolicy:
    """Write ``policy.onnx``, ``policy.pt`` (TorchScript) and ``policy.json``.

    Both networks take the observation groups of the actor, joined in the order of ``obs_groups["actor"]``, shape
    ``(batch, n)``, float32. They normalise them if the policy does, and return the actions without noise,
    ``(batch, num_actions)``. Picture groups are inputs of their own. A recurrent ONNX network takes and returns its
    state, ``(layers, batch, width)``. Before anything is written both are compared with the policy.

    Args:
        runner: The runner with the policy.
        folder: Folder of the files; files of these names are replaced.
        task: Name of the task in the metadata; by default the one in the run folder.
        run: Name of the run; by default that of the run folder.

    Raises:
        ExportError: if the network cannot be exported, if an exported network acts differently from the policy, or if
            the files cannot be written.
    """
    policy = runner.alg.get_policy()
    metadata = describe_policy(runner, task, run)
    with _silent():
        try:
            script = torch.jit.script(policy.as_jit().to("cpu").eval())
            model = _to_onnx(policy)
        except Exception as error:  # a network of the user's may fail in any way
            reason = (str(error).splitlines() or [""])[0][:300]
            raise ExportError(
                f"{type(policy).__name__} cannot be exported: {type(error).__name__}: {reason}"
            ) from error
    with _silent():
        onnx_file = model.SerializeToString()
        largest, results = check_policy(policy, onnx_file, script, metadata["network"], str(runner.device))
    check: CheckInfo = {"tolerance": TOLERANCE, "largest_action": largest, "results": results}
    _raise_if_different(check)
    metadata["check"] = check
    return _write(Path(folder), model, script, metadata)


def _raise_if_different(check: CheckInfo) -> None:
    # Relative to the largest action, as actions may be of any size.
    allowed = check["tolerance"] * max(1.0, check["largest_action"])
    for name, found in check["results"].items():
        difference = found["largest_difference"]
        if difference is not None and not difference <= allowed:
            raise ExportError(
                f"{name}: the exported policy's actions differ from the policy's by {difference:.3g}"
                f" ({found['by']}), {allowed:.3g} is allowed; nothing was written"
            )


def _to_onnx(policy: MLPModel) -> onnx.ModelProto:
    """The policy as an ONNX model that takes any number of environments."""
    network = policy.as_onnx(verbose=False).to("cpu").eval()
    if (plain := plain_onnx(policy, network)) is not None:
        return plain
    batch = torch.export.Dim("batch", min=1)
    axes = [1 if name in ("h_in", "c_in") else 0 for name in network.input_names]
    # Two environments: torch takes a size of 1 in the example for a constant.
    example = [torch.cat([x, x], dim=axis) for x, axis in zip(network.get_dummy_inputs(), axes, strict=True)]
    shapes = tuple({axis: batch} for axis in axes)
    program = torch.onnx.export(
        network,
        tuple(example),
        opset_version=OPSET,
        input_names=network.input_names,
        output_names=network.output_names,
        dynamo=True,
        # A network of pictures has them as *args, whose shapes are a tuple of their own.
        dynamic_shapes=(shapes[0], shapes[1:]) if isinstance(policy, CNNModel) else shapes,
        verbose=False,
    )
    if program is None:
        raise RuntimeError("torch.onnx.export returned nothing")
    model = program.model_proto
    _remove_traces(model)
    return model


def _remove_traces(model: onnx.ModelProto) -> None:
    """Remove where the code of each operation was: torch notes paths of this machine, half of a small file."""
    graph = model.graph
    functions = [node for function in model.functions for node in function.node]
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info, *graph.initializer, *functions):
        del part.metadata_props[:]
        part.doc_string = ""


def _write(
    folder: Path, model: onnx.ModelProto, script: torch.jit.ScriptModule, metadata: PolicyMetadata
) -> ExportedPolicy:
    """Write all files beside the old ones, and then put them in their place.

    Raises:
        ExportError: if they cannot be written; the old ones are as they were.
    """
    files = ExportedPolicy(folder / "policy.onnx", folder / "policy.pt", folder / "policy.json", metadata)
    text = _short_lists(json.dumps(metadata, indent=1, allow_nan=False))
    for key, value in metadata.items():
        model.metadata_props.add(key=key, value=json.dumps(value, allow_nan=False))
    buffer = io.BytesIO()
    with _silent():
        torch.jit.save(script, buffer, _extra_files={METADATA_FILE: text})
    contents = {
        files.onnx: model.SerializeToString(),
        files.torchscript: buffer.getvalue(),
        files.json: (text + "\n").encode(),
    }
    parts = {path: path.with_name(path.name + ".part") for path in contents}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, data in contents.items():
            parts[path].write_bytes(data)
        for path, part in parts.items():
            os.replace(part, path)
    except OSError as error:
        place = error.filename or folder
        raise ExportError(f"{place}: could not be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            for part in parts.values():
                part.unlink(missing_ok=True)
    # Weights of the policy.onnx that was there before, if it kept them outside; ours are inside the file.
    (folder / "policy.onnx.data").unlink(missing_ok=True)
    return files


def _short_lists(text: str) -> str:
    """JSON with each list of plain values on one line."""
    flat = re.compile(r"\[\n\s*([^\[\]{}]*?)\n\s*\]")
    return flat.sub(lambda match: "[" + re.sub(r"\n\s*", " ", match[1]) + "]", text)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Suppress what torch's exporters print, log and warn of."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")  # deprecations inside torch's own exporters
        log.setLevel(logging.ERROR)
        try:
            yield
        finally:
            log.setLevel(level)
