# SPDX-License-Identifier: Apache-2.0
"""A policy from an exported ONNX file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from .errors import CheckpointError
from .policy_metadata import read_policy_metadata
from .policy_parts import action_terms, articulations, observation_groups, plain
from .vec_env import RslRlVecEnvWrapper

__all__ = ["OnnxPolicy"]


class OnnxPolicy:
    """Acts as an exported ``policy.onnx``, by onnxruntime: a :class:`Policy` for all environments at once.

    Actions are clipped as in the training. A recurrent network's state is kept here, zero at the start of an episode.

    Attributes:
        metadata: What stands in the file beside the network.
    """

    def __init__(self, path: str | os.PathLike, env: RslRlVecEnvWrapper):
        """Read the file and hold it against the environment.

        Args:
            path: the file, written by :func:`export_policy`.
            env: the wrapped environment it shall act in.

        Raises:
            CheckpointError: if the file is missing, damaged, without metadata, or of other observations, joints or
                actions than the environment's; the message names each.
        """
        path = Path(path).expanduser()
        self.metadata = read_policy_metadata(path)
        problems = list(_misfits(self.metadata, env))
        if problems:
            of = f" (of {self.metadata['task']})" if self.metadata.get("task") else ""
            raise CheckpointError(
                f"{path}{of} does not fit this environment:\n" + "\n".join(f"  {p}" for p in problems)
            )
        self._session = _open(path, str(env.device))
        network = self.metadata["network"]
        self._inputs: list[dict[str, Any]] = network["inputs"]
        self._states: list[dict[str, Any]] = network["states"]
        self._names = ["actions", *(state["output"] for state in self._states)]
        self._clip = self.metadata["actions"]["clip"]
        self._num_envs, self._device = env.num_envs, env.device
        self._hidden: dict[str, np.ndarray] = {}
        self.reset()

    def __call__(self, obs: TensorDict) -> torch.Tensor:
        arrays: dict[str, np.ndarray] = {}
        for entry in self._inputs:
            groups = [obs[name] for name in entry["groups"]]
            joined = torch.cat(groups, dim=-1) if groups else torch.zeros(self._num_envs, 0)
            arrays[entry["name"]] = joined.detach().to("cpu", torch.float32).contiguous().numpy()
        actions, *hidden = self._session.run(self._names, arrays | self._hidden)
        self._hidden = {s["input"]: value for s, value in zip(self._states, hidden, strict=True)}
        out = torch.from_numpy(actions).to(self._device)
        return out if self._clip is None else out.clamp(-self._clip, self._clip)

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Forget the past of the environments whose episode ended, ``dones`` (num_envs,), or of all."""
        if dones is None:
            shapes = {s["input"]: [self._num_envs if n == "batch" else n for n in s["shape"]] for s in self._states}
            self._hidden = {name: np.zeros(shape, dtype=np.float32) for name, shape in shapes.items()}
            return
        if self._states:
            ended = dones.cpu().numpy().astype(bool)
            for name, value in self._hidden.items():
                self._hidden[name] = np.where(ended[None, :, None], np.float32(0.0), value)


def _open(path: Path, device: str) -> Any:
    try:
        import onnxruntime
    except ImportError:
        raise CheckpointError(f"{path}: an ONNX file needs onnxruntime: pip install stripe-newton[export]") from None
    there = onnxruntime.get_available_providers()
    wanted = ["CUDAExecutionProvider"] if device.startswith("cuda") else []
    providers = [p for p in [*wanted, "CPUExecutionProvider"] if p in there]
    try:
        return onnxruntime.InferenceSession(str(path), providers=providers)
    except Exception as error:  # its errors have no common base
        raise CheckpointError(f"{path}: onnxruntime cannot run it ({str(error).splitlines()[0][:160]})") from None


def _misfits(metadata: dict[str, Any], env: RslRlVecEnvWrapper) -> Iterator[str]:
    """What of a policy is not as in the environment."""
    inner, obs = env.unwrapped, env.get_observations()
    there = {name: tuple(value.shape[1:]) for name, value in obs.items() if isinstance(value, torch.Tensor)}
    wanted = metadata["observations"]
    known = {g["name"]: there[g["name"]] for g in wanted if g["name"] in there}
    groups = {g["name"]: g for g in plain(observation_groups(inner, known))}
    for group in wanted:
        name, mine = group["name"], groups.get(group["name"])
        if mine is None:
            yield f"observations '{name}': it has no such group, but {', '.join(there)}"
            continue
        own, its = (_sizes(g["terms"]) for g in (group, mine))
        if own is not None and its is not None and own != its:
            yield f"observations '{name}': the policy reads {_told(own)}; the environment has {_told(its)}"
        elif tuple(group["shape"]) != tuple(mine["shape"]):
            yield f"observations '{name}': the policy reads {tuple(group['shape'])}, it has {tuple(mine['shape'])}"
    if metadata["actions"]["size"] != env.num_actions:
        yield f"actions: the policy gives {metadata['actions']['size']}, it takes {env.num_actions}"
    for what, moved, present in _joints(metadata, inner):
        if moved != present:
            yield f"{what}: the policy moves {', '.join(moved)}; the environment has {', '.join(present)}"


def _joints(metadata: dict[str, Any], env: Any) -> Iterator[tuple[str, list[str], list[str]]]:
    """What is moved, the policy's joints, and the environment's: by actions, or of whole assets where either has no
    action terms."""
    assets = articulations(env)
    own, its = metadata["actions"]["terms"], plain(action_terms(env, assets))
    if own is not None and its is not None:
        yield (
            "joints",
            [j for term in own for j in term["joint_names"]],
            [j for term in its for j in term["joint_names"]],
        )
        return
    for name, asset in metadata["assets"].items():
        if name in assets:
            yield f"joints of '{name}'", asset["joint_names"], list(assets[name]["joint_names"])


def _sizes(terms: list[dict[str, Any]] | None) -> list[tuple[str, int]] | None:
    """Names and sizes of terms, histories included."""
    return None if terms is None else [(t["name"], t["size"] * max(1, t["history_length"])) for t in terms]


def _told(sizes: list[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in sizes)
