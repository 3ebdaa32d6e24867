# SPDX-License-Identifier: Apache-2.0
"""Metadata of an exported policy: all that is needed to run it on a robot, written beside the network."""

from __future__ import annotations

import importlib.metadata
import json
import os
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rsl_rl.models import CNNModel, MLPModel

from stripe_newton.input_files import why_no_file
from stripe_newton.rl.errors import CheckpointError
from stripe_newton.rl.torch_vector_env import TorchVectorEnv, rl_env_of
from stripe_newton.value_types import mismatches

from .env_description import action_terms, articulations, commands, observation_groups, sensors, sensors_of
from .metadata_format import NetworkInfo, NetworkInput, NetworkState, Plain, PolicyMetadata
from .plain_values import plain, settings

if TYPE_CHECKING:
    from stripe_newton.rl.runner import OnPolicyRunner

__all__ = ["FORMAT_VERSION", "METADATA_FILE", "describe_policy", "read_policy_metadata"]

FORMAT_VERSION = 1
"""Version of the format; files of a later one are not read."""
METADATA_FILE = "metadata.json"
"""Name of the metadata within a TorchScript file."""
SECTIONS = tuple(PolicyMetadata.__annotations__)
"""Keys of the metadata, each a string of JSON in an ONNX file's ``metadata_props``."""
PACKAGES = ("stripe-newton", "newton", "warp-lang", "mujoco", "torch", "rsl-rl-lib", "onnx")
"""Packages whose versions are recorded."""


def describe_policy(runner: OnPolicyRunner, task: str | None = None, run: str | None = None) -> PolicyMetadata:
    """Describe a policy and the environment that it acts in.

    Parts that the environment does not have are None or empty: a direct one has no terms.

    Args:
        runner: The runner with the policy.
        task: Name of the task; by default the one in the run folder.
        run: Name of the run; by default that of the run folder.
    """
    env, folder = runner.env.unwrapped, runner.run_folder
    obs, model = runner.env.get_observations(), runner.alg.get_policy()
    names = [*model.obs_groups, *_picture_groups(model)]
    groups = observation_groups(env, {name: tuple(obs[name].shape[1:]) for name in names})
    assets = articulations(env)
    return {
        "format_version": FORMAT_VERSION,
        "task": task or (folder.read_task() if folder is not None else None),
        "run": run or (folder.path.name if folder is not None else None),
        "iteration": runner.iterations_done,
        "versions": {name: version for name in PACKAGES if (version := _version(name))},
        "rates": _rates(env),
        "solver": _solver(env),
        "assets": assets,
        "actions": {
            "size": runner.env.num_actions,
            "clip": runner.env.clip_actions,
            "terms": action_terms(env, assets),
        },
        "observations": groups,
        "sensors": sensors(sensors_of(env), groups),
        "commands": commands(env),
        "network": _network(model),
        "check": None,
    }


def read_policy_metadata(path: str | os.PathLike) -> PolicyMetadata:
    """Read the metadata of an exported policy.

    Args:
        path: ``policy.onnx``, ``policy.pt``, ``policy.json``, or the folder or run folder that has them.

    Raises:
        CheckpointError: if there is no such file, if it has no metadata, or if it is of a later version.
    """
    path = Path(path).expanduser()
    if path.is_dir():
        inside = [path / "policy.json", path / "exported" / "policy.json"]
        path = next((file for file in inside if file.is_file()), inside[0])
    if problem := why_no_file(path):
        raise CheckpointError(f"{path}: {problem}; 'stripe-newton export RUN' writes it")
    read = {".onnx": _read_onnx, ".json": _read_json}.get(path.suffix, _read_torchscript)
    try:
        data = read(path)
    except (ValueError, KeyError, OSError, RuntimeError, NotImplementedError, zipfile.BadZipFile) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise CheckpointError(f"{path}: has no metadata of a policy ({reason})") from None
    version = data.get("format_version") if isinstance(data, dict) else None
    if not isinstance(version, int) or isinstance(version, bool):
        raise CheckpointError(f"{path}: has no metadata of a policy; was it written by 'stripe-newton export RUN'?")
    if version > FORMAT_VERSION:
        raise CheckpointError(f"{path}: has metadata of version {version}, this package reads up to {FORMAT_VERSION}")
    if wrong := list(mismatches(data, PolicyMetadata)):
        raise CheckpointError(f"{path}: has wrong metadata: {'; '.join(wrong[:3])}")
    metadata = cast(PolicyMetadata, data)
    described = {group["name"] for group in metadata["observations"]}
    for name in (name for entry in metadata["network"]["inputs"] for name in entry["groups"]):
        if name not in described:  # what the network reads could not be compared with an environment
            raise CheckpointError(f"{path}: has wrong metadata: observations: lack the group '{name}' of the network")
    return metadata


def _read_onnx(path: Path) -> Plain:
    import onnx  # here, as the other files can be read without it

    try:
        model = onnx.load(str(path), load_external_data=False)
    except Exception:  # protobuf's own, which has no base in common with others
        raise ValueError("it is not an ONNX file") from None
    return {p.key: json.loads(p.value) for p in model.metadata_props if p.key in SECTIONS}


def _read_json(path: Path) -> Plain:
    return json.loads(path.read_text(encoding="utf-8"))


def _read_torchscript(path: Path) -> Plain:
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if n.endswith(f"/extra/{METADATA_FILE}")]
        if not names:
            raise ValueError(f"it contains no {METADATA_FILE}")
        return json.loads(archive.read(names[0]))


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _rates(env: TorchVectorEnv) -> dict[str, Plain]:
    """Steps of the physics and of the environment [s], and how many of the former are in the latter."""
    # Environments of other packages too: configs after the manner of Isaac Lab have these fields.
    sim = getattr(env.cfg, "sim", None)
    return {
        "physics_dt": plain(getattr(sim, "dt", None)),
        "decimation": plain(getattr(env.cfg, "decimation", None)),
        "step_dt": plain(env.step_dt),
    }


def _solver(env: TorchVectorEnv) -> dict[str, Plain] | None:
    """Settings of the solver."""
    inner = rl_env_of(env)
    return None if inner is None else settings(inner.cfg.sim.solver, "save_to_mjcf")


def _picture_groups(model: MLPModel) -> list[str]:
    """Observation groups of pictures, which are inputs of their own."""
    return list(model.obs_groups_2d) if isinstance(model, CNNModel) else []


def _network(model: MLPModel) -> NetworkInfo:
    """Inputs and outputs of the ONNX graph by name, and the normaliser before its first layer."""
    # All flat groups are one input, which for a network of pictures alone is empty.
    inputs: list[NetworkInput] = [{"name": "obs", "groups": list(model.obs_groups), "shape": ["batch", model.obs_dim]}]
    for i, group in enumerate(_picture_groups(model)):
        shape = ["batch", model.obs_channels_2d[i], *model.obs_dims_2d[i]]
        inputs.append({"name": group, "groups": [group], "shape": shape})
    states: list[NetworkState] = []
    if model.is_recurrent:
        rnn, onnx_model = model.rnn.rnn, model.as_onnx(verbose=False)
        shape = [rnn.num_layers, "batch", rnn.hidden_size]
        # After the observations, flat and pictures.
        pairs = zip(onnx_model.input_names[len(inputs) :], onnx_model.output_names[1:], strict=True)
        states = [{"input": i, "output": o, "shape": shape} for i, o in pairs]
    return {
        "type": type(model).__name__,
        "inputs": inputs,
        "states": states,
        "outputs": [{"name": "actions", "shape": ["batch", "actions"]}],
        "normalizer": _normalizer(model),
        "distribution": None if model.distribution is None else type(model.distribution).__name__,
    }


def _normalizer(model: MLPModel) -> dict[str, Plain] | None:
    """The normaliser of the network's flat observations, or None."""
    if not model.obs_normalization:
        return None
    norm = model.obs_normalizer
    return {
        "formula": "(obs - mean) / (std + eps)",
        "inside": True,
        "eps": plain(norm.eps),
        "mean": plain(norm.mean),
        "std": plain(norm.std),
    }
