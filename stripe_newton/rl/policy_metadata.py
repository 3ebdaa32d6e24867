# SPDX-License-Identifier: Apache-2.0
"""What stands in the file of an exported policy beside its network: enough to run it on a robot."""

from __future__ import annotations

import importlib.metadata
import json
import os
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import CheckpointError
from .policy_parts import action_terms, articulations, commands, observation_groups, plain, sensors, settings

if TYPE_CHECKING:
    from .runner import OnPolicyRunner

__all__ = ["FORMAT_VERSION", "METADATA_FILE", "describe_policy", "read_policy_metadata"]

FORMAT_VERSION = 1
"""Version of the metadata; files of a later one are not read."""
METADATA_FILE = "metadata.json"
"""Name of the metadata within a TorchScript file."""
SECTIONS = (
    "format_version", "task", "run", "iteration", "versions", "rates", "solver", "assets", "actions", "observations",
    "sensors", "commands", "network", "check",
)  # fmt: skip
"""Keys of the metadata, each a string of JSON in an ONNX file's ``metadata_props``."""
PACKAGES = ("stripe-newton", "newton", "warp-lang", "mujoco", "torch", "rsl-rl-lib", "onnx")


def describe_policy(runner: OnPolicyRunner, task: str | None = None, run: str | None = None) -> dict[str, Any]:
    """Describe a policy and what it acts on: plain values, as JSON has them.

    What an environment does not say is None or empty: a direct one has no terms.

    Args:
        runner: the runner with the policy.
        task: name of the task; by default the one that the run folder names.
        run: name of the run; by default that of the run folder.
    """
    env, folder = runner.env.unwrapped, runner.run_folder
    assets, solver = articulations(env), getattr(getattr(env.cfg, "sim", None), "solver", None)
    obs, model = runner.env.get_observations(), runner.alg.get_policy()
    names = [*model.obs_groups, *getattr(model, "obs_groups_2d", [])]
    groups = observation_groups(env, {name: tuple(obs[name].shape[1:]) for name in names})
    return plain(
        {
            "format_version": FORMAT_VERSION,
            "task": task or (folder.read_task() if folder is not None else None),
            "run": run or (folder.path.name if folder is not None else None),
            "iteration": runner.iterations_done,
            "versions": {name: version for name in PACKAGES if (version := _version(name))},
            "rates": _rates(env),
            "solver": None if solver is None else settings(solver, "save_to_mjcf"),
            "assets": assets,
            "actions": {
                "size": runner.env.num_actions,
                "clip": runner.env.clip_actions,
                "terms": action_terms(env, assets),
            },
            "observations": groups,
            "sensors": sensors(env, groups),
            "commands": commands(env),
            "network": _network(model),
            "check": None,
        }
    )


def read_policy_metadata(path: str | os.PathLike) -> dict[str, Any]:
    """The metadata of an exported policy.

    Args:
        path: ``policy.onnx``, ``policy.pt``, ``policy.json``, or the folder or run folder that holds them.

    Raises:
        CheckpointError: if there is no such file, if it has no metadata, or if it is of a later version.
    """
    path = Path(path).expanduser()
    if path.is_dir():
        inside = [path / "policy.json", path / "exported" / "policy.json"]
        path = next((file for file in inside if file.is_file()), inside[0])
    if not path.is_file():
        raise CheckpointError(f"{path}: does not exist; 'stripe-newton export RUN' writes it")
    read = {".onnx": _read_onnx, ".json": _read_json}.get(path.suffix, _read_torchscript)
    try:
        data = read(path)
    except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path}: has no metadata of a policy ({str(error).splitlines()[0][:120]})") from None
    if not isinstance(data, dict) or not isinstance(data.get("format_version"), int):
        raise CheckpointError(f"{path}: has no metadata of a policy; was it written by 'stripe-newton export RUN'?")
    if data["format_version"] > FORMAT_VERSION:
        version = data["format_version"]
        raise CheckpointError(f"{path}: has metadata of version {version}, this package reads up to {FORMAT_VERSION}")
    return data


def _read_onnx(path: Path) -> dict[str, Any]:
    import onnx

    try:
        model = onnx.load(str(path), load_external_data=False)
    except Exception:  # protobuf's own, which has no base in common with others
        raise ValueError("it is no ONNX file") from None
    return {p.key: json.loads(p.value) for p in model.metadata_props if p.key in SECTIONS}


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _read_torchscript(path: Path) -> Any:
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if n.endswith(f"/extra/{METADATA_FILE}")]
        if not names:
            raise ValueError(f"it holds no {METADATA_FILE}")
        return json.loads(archive.read(names[0]))


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _rates(env: Any) -> dict[str, Any]:
    """Physics step, environment step [s], and how many of the former are in the latter."""
    sim = getattr(env.cfg, "sim", None)
    return {
        "physics_dt": getattr(sim, "dt", None),
        "decimation": getattr(env.cfg, "decimation", None),
        "step_dt": getattr(env, "step_dt", None),
    }


def _network(model: Any) -> dict[str, Any]:
    """Inputs and outputs of the ONNX graph by name, and what it does before its first layer."""
    images = getattr(model, "obs_groups_2d", [])
    inputs: list[dict[str, Any]] = [
        {"name": "obs", "groups": list(model.obs_groups), "shape": ["batch", model.obs_dim]}  # of a CNN maybe empty
    ]
    for i, group in enumerate(images):
        shape = ["batch", model.obs_channels_2d[i], *model.obs_dims_2d[i]]
        inputs.append({"name": group, "groups": [group], "shape": shape})
    states = []
    if model.is_recurrent:
        rnn, onnx_model = model.rnn.rnn, model.as_onnx(verbose=False)
        shape = [rnn.num_layers, "batch", rnn.hidden_size]
        pairs = zip(onnx_model.input_names[1:], onnx_model.output_names[1:], strict=True)
        states = [{"input": i, "output": o, "shape": shape} for i, o in pairs]
    normalizer = None
    if getattr(model, "obs_normalization", False):
        norm = model.obs_normalizer
        normalizer = {
            "formula": "(obs - mean) / (std + eps)",
            "inside": True,
            "eps": norm.eps,
            "mean": norm.mean,
            "std": norm.std,
        }
    return {
        "type": type(model).__name__,
        "inputs": inputs,
        "states": states,
        "outputs": [{"name": "actions", "shape": ["batch", "actions"]}],
        "normalizer": normalizer,
        "distribution": None if model.distribution is None else type(model.distribution).__name__,
    }
