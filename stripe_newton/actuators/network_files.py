# SPDX-License-Identifier: Apache-2.0
"""Network files of actuators: converted into the ONNX files that Newton's neural drives read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import onnx
import torch
import warp as wp
from warp_nn.runtime import OnnxRuntime  # type: ignore[import-untyped]

from stripe_newton.input_files import why_no_file

from . import lstm
from .lstm import LSTM_NAMES, lstm_model, with_metadata

__all__ = ["prepare_lstm", "prepare_mlp"]

_UNSAFE_OPERATORS = {"from_file", "save", "CallMethod", "CallFunction", "fork", "awaitable", "PythonOp"}
"""Operators of TorchScript that write files, or call what the graph does not show."""
_MOST_CODE = 1 << 24
"""Bytes that are read of a file of code: a small archive can hold gigabytes."""
_FORMATS = "ONNX (.onnx) and TorchScript (.pt, .pth, .jit)"


def prepare_mlp(file: str, **given: object) -> Path:
    """An ONNX file for ``newton.actuators.DriveNeuralMLP``, in a cache beside Warp's kernels.

    Args:
        file: Path of the network.
        given: Overrides the metadata of the file: pos_scale, vel_scale, effort_scale, input_order, input_idx.

    Raises:
        ValueError: if there is no such file, or its format or its network is another one.
    """

    def make(path: Path) -> onnx.ModelProto:
        metadata: dict[str, Any] = {}
        if _is_onnx(path):
            model = _load_onnx(path)
            metadata = _metadata(model, path)
            # Newton's present name of torque_scale, which older files have.
            metadata.setdefault("effort_scale", metadata.pop("torque_scale", 1.0))
        # Defaults, then the file, then the config.
        metadata = {"input_order": "pos_vel", "input_idx": [0], **metadata, **given, "model_type": "mlp"}
        width = 2 * len(metadata["input_idx"])
        if not _is_onnx(path):
            model = _export(_load_torch(path), torch.zeros(1, width), path)
        _check_shapes(model, path, [(None, width)], [(None, 1)], f"input_idx {metadata['input_idx']}")
        return with_metadata(model, metadata)

    return _cached(file, make, "mlp", given)


def prepare_lstm(file: str) -> Path:
    """An ONNX file for ``newton.actuators.DriveNeuralLSTM``, in a cache beside Warp's kernels.

    Args:
        file: Path of the network.

    Raises:
        ValueError: if there is no such file, or its format or its network is another one.
    """

    def make(path: Path) -> onnx.ModelProto:
        if not _is_onnx(path):
            return lstm_model(_load_torch(path), path)
        model = _load_onnx(path)
        state = (None, None, None)
        _check_shapes(model, path, [(None, None, 2), state, state], [(None, 1), state, state], "an LSTM")
        names = [[value.name for value in values] for values in (_inputs(model), model.graph.output)]
        sizes = [d.dim_value for d in _inputs(model)[1].type.tensor_type.shape.dim]
        metadata = {k: n for keys, own in zip(LSTM_NAMES, names, strict=True) for k, n in zip(keys, own, strict=True)}
        metadata |= {"num_layers": sizes[0], "hidden_size": sizes[2]}
        metadata |= _metadata(model, path) | {"model_type": "lstm"}
        if not (metadata["num_layers"] and metadata["hidden_size"]):
            raise ValueError(f"network_file '{path}': neither shapes nor metadata say its num_layers and hidden_size")
        return with_metadata(model, metadata)

    return _cached(file, make, "lstm", {})


# -- reading


def _is_onnx(path: Path) -> bool:
    return path.suffix.lower() == ".onnx"


def _cached(file: str, make: Callable[[Path], onnx.ModelProto], kind: str, given: Mapping[str, object]) -> Path:
    """The file that ``make`` returns for a network, made once for each content and each settings."""
    path = Path(file).expanduser()
    if problem := why_no_file(path):
        raise ValueError(f"network_file '{file}': {problem}")
    if path.suffix.lower() not in (".onnx", ".pt", ".pth", ".jit"):
        raise ValueError(f"network_file '{file}': '{path.suffix}' is no known format, there are {_FORMATS}")
    digest = hashlib.sha256(path.read_bytes())
    digest.update(json.dumps([kind, path.suffix, dict(sorted(given.items()))]).encode())
    for source in (__file__, lstm.__file__):  # another version of the conversion converts again
        digest.update(Path(source).read_bytes())
    wp.init()  # chooses the folder of the cache
    folder = Path(wp.config.kernel_cache_dir) / "stripe_newton" / "networks"
    made = folder / f"{path.stem}_{digest.hexdigest()[:16]}.onnx"
    if not made.is_file():
        model = make(path)
        _check_operators(model, path)
        folder.mkdir(parents=True, exist_ok=True)
        # Renamed into its place, so that another process never reads half a file.
        with tempfile.TemporaryDirectory(dir=folder) as own:
            onnx.save(model, f"{own}/network.onnx")
            os.replace(f"{own}/network.onnx", made)
    return made


def _load_onnx(path: Path) -> onnx.ModelProto:
    try:
        model = onnx.load(str(path))
        onnx.checker.check_model(model)
    except Exception as error:
        raise ValueError(f"network_file '{path}': it is no ONNX model: {error}") from error
    return model


def _load_torch(path: Path) -> torch.jit.ScriptModule:
    """The network of a TorchScript file, on the CPU."""
    try:
        with zipfile.ZipFile(path) as archive:
            inside = {name.split("/", 1)[-1] for name in archive.namelist()}
    except zipfile.BadZipFile as error:
        raise ValueError(f"network_file '{path}': it is no file of torch; there are {_FORMATS}") from error
    if not any(name.startswith("code/") for name in inside):
        raise ValueError(
            f"network_file '{path}': it is no TorchScript; write it by torch.jit.save(torch.jit.script(network), path) "
            "or torch.onnx.export"
        )
    # Code that runs while the file is read, before it can be checked.
    if _has_word(path, b"__setstate__"):
        raise ValueError(f"network_file '{path}': it runs code of its own when it is read (__setstate__)")
    try:
        network = torch.jit.load(str(path), map_location="cpu").eval()
    except Exception as error:
        raise ValueError(f"network_file '{path}': torch cannot read it: {error}") from error
    if network._c._get_forward_hooks() or network._c._get_forward_pre_hooks():
        raise ValueError(f"network_file '{path}': it has hooks; write the network without them")
    if problem := next(_unsafe(network.inlined_graph), ""):
        raise ValueError(f"network_file '{path}': its operator '{problem}' is none of a network, or writes files")
    return network


def _has_word(path: Path, word: bytes) -> bool:
    """Whether code in a TorchScript file has a word."""
    with zipfile.ZipFile(path) as archive:
        sources = (name for name in archive.namelist() if "/code/" in f"/{name}" and name.endswith(".py"))
        return any(word in archive.open(name).read(_MOST_CODE) for name in sources)


def _unsafe(block: torch._C.Graph | torch._C.Block) -> Iterator[str]:
    """Operators of a graph that reach beyond tensors: TorchScript can write files."""
    for node in block.nodes():
        space, _, name = node.kind().partition("::")
        if space not in ("aten", "prim") or name in _UNSAFE_OPERATORS:
            yield node.kind()
        for inner in node.blocks():
            yield from _unsafe(inner)


def _metadata(model: onnx.ModelProto, path: Path) -> dict[str, Any]:
    found = {p.key: p.value for p in model.metadata_props}
    try:
        return json.loads(found["metadata"]) if "metadata" in found else {k: _parsed(v) for k, v in found.items()}
    except json.JSONDecodeError as error:
        raise ValueError(f"network_file '{path}': its metadata are no JSON: {error}") from error


def _parsed(text: str) -> object:
    with contextlib.suppress(json.JSONDecodeError):
        return json.loads(text)
    return text


def _inputs(model: onnx.ModelProto) -> list[onnx.ValueInfoProto]:
    """Inputs of a model, without constants, which old ONNX files list among them."""
    constants = {value.name for value in model.graph.initializer}
    return [value for value in model.graph.input if value.name not in constants]


Shape = tuple[int | None, ...]
"""Sizes of the dimensions of an array; None for any size."""


def _check_shapes(model: onnx.ModelProto, path: Path, inputs: list[Shape], outputs: list[Shape], why: str) -> None:
    for what, values, wanted in (("input", _inputs(model), inputs), ("output", model.graph.output, outputs)):
        shapes = [tuple(d.dim_value or None for d in v.type.tensor_type.shape.dim) for v in values]
        if len(shapes) != len(wanted) or not all(map(_fits, shapes, wanted)):
            show = ", ".join(str(s).replace("None", "n") for s in shapes)
            must = ", ".join(str(s).replace("None", "n") for s in wanted)
            raise ValueError(f"network_file '{path}': {what}s have shapes {show}; {why} needs {must}")


def _fits(shape: Shape, wanted: Shape) -> bool:
    return len(shape) == len(wanted) and all(a is None or b is None or a == b for a, b in zip(shape, wanted))


def _check_operators(model: onnx.ModelProto, path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        onnx.save(model, f"{folder}/network.onnx")
        try:
            OnnxRuntime(f"{folder}/network.onnx", device="cpu")
        except (NotImplementedError, ValueError) as error:
            raise ValueError(f"network_file '{path}': Warp-NN cannot run it: {error}") from error


# -- converting


def _export(network: torch.jit.ScriptModule, example: torch.Tensor, path: Path) -> onnx.ModelProto:
    """A TorchScript network as ONNX, with any number of rows."""
    rows = {"input": {0: "n"}, "output": {0: "n"}}
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")  # this exporter is deprecated, but the new one takes no TorchScript
            network(example)
            with tempfile.TemporaryDirectory() as folder:
                torch.onnx.export(
                    network, (example,), f"{folder}/n.onnx", dynamo=False, dynamic_axes=rows,
                    input_names=["input"], output_names=["output"],
                )  # fmt: skip
                return onnx.load(f"{folder}/n.onnx")
    except Exception as error:
        shape = tuple(example.shape)
        raise ValueError(f"network_file '{path}': it does not take an input of shape {shape}: {error}") from error
