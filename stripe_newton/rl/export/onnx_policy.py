# SPDX-License-Identifier: Apache-2.0
"""OnnxPolicy: a policy that acts as an exported ONNX file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from tensordict import TensorDict

from stripe_newton.rl.errors import CheckpointError, DivergedError
from stripe_newton.rl.torch_vector_env import TorchVectorEnv
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper

from .bounded_session import BoundedSession
from .env_description import action_terms, articulations, observation_groups
from .metadata_format import NetworkInfo, ObservationGroupInfo, ObservationTermInfo, PolicyMetadata
from .policy_metadata import read_policy_metadata

if TYPE_CHECKING:
    import onnxruntime

__all__ = ["OnnxPolicy"]


class OnnxPolicy:
    """Acts as an exported ``policy.onnx``, by onnxruntime: a :class:`Policy` for all environments at once.

    Actions are clipped as in the training. A recurrent network's state is kept here; it is zero at the start of an
    episode.

    Attributes:
        metadata: Metadata in the file.
    """

    def __init__(self, path: str | os.PathLike, env: RslRlVecEnvWrapper):
        """Read the file and compare it with the environment.

        Args:
            path: The file, written by :func:`export_policy`.
            env: The wrapped environment that the policy will act in.

        Raises:
            CheckpointError: if the file is missing, damaged, without metadata, or of other observations, joints or
                actions than the environment's; the message names each.
        """
        self._path = path = Path(path).expanduser()
        self.metadata = read_policy_metadata(path)
        problems = list(_mismatches(self.metadata, env))
        if problems:
            of = f" (of {self.metadata['task']})" if self.metadata.get("task") else ""
            raise CheckpointError(
                f"{path}{of} does not fit this environment:\n" + "\n".join(f"  {p}" for p in problems)
            )
        self._session = BoundedSession(path, str(env.device))
        network = self.metadata["network"]
        self._inputs, self._states = network["inputs"], network["states"]
        _check_names(path, self._session.network, network)
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
        if not np.isfinite(actions).all():
            finite = all(np.isfinite(array).all() for array in arrays.values())
            cause = "its weights are not finite: the training had diverged" if finite else "so were its observations"
            raise DivergedError(f"{self._path}: the policy's actions are not finite; {cause}")
        self._hidden = {s["input"]: value for s, value in zip(self._states, hidden, strict=True)}
        out = torch.from_numpy(actions).to(self._device)
        return out if self._clip is None else out.clamp(-self._clip, self._clip)

    def reset(self, dones: torch.Tensor | None = None) -> None:
        """Clear the memory of the environments whose episode ended, ``dones`` ``(num_envs,)``, or of all."""
        if dones is None:
            shapes = {
                s["input"]: [self._num_envs if n == "batch" else int(n) for n in s["shape"]] for s in self._states
            }
            self._hidden = {name: np.zeros(shape, dtype=np.float32) for name, shape in shapes.items()}
            return
        if self._states:
            ended = dones.cpu().numpy().astype(bool)
            for name, value in self._hidden.items():
                self._hidden[name] = np.where(ended[None, :, None], np.float32(0.0), value)


def _check_names(path: Path, session: onnxruntime.InferenceSession, network: NetworkInfo) -> None:
    """Check that the network has the inputs and outputs that its metadata names, and states of their sizes.

    Raises:
        CheckpointError: if it has not.
    """
    inputs = {item.name: item.shape for item in session.get_inputs()}
    outputs = [item.name for item in session.get_outputs()]
    named = [entry["name"] for entry in network["inputs"]] + [state["input"] for state in network["states"]]
    wrong = sorted(set(named) ^ set(inputs))
    wrong += [name for name in ("actions", *(state["output"] for state in network["states"])) if name not in outputs]
    for state in network["states"]:
        sizes = [size for size in inputs.get(state["input"], ()) if isinstance(size, int)]
        if sizes != [size for size in state["shape"] if size != "batch"]:
            wrong.append(f"{state['input']} of shape {state['shape']}")
    if wrong:
        raise CheckpointError(f"{path}: its metadata are of another network: they differ in {', '.join(wrong)}")


# -- comparison with the environment


def _mismatches(metadata: PolicyMetadata, env: RslRlVecEnvWrapper) -> Iterator[str]:
    """Differences between the environment and what the policy needs."""
    yield from _group_mismatches(metadata["observations"], env)
    if metadata["actions"]["size"] != env.num_actions:
        yield f"actions: the policy returns {metadata['actions']['size']}, the environment takes {env.num_actions}"
    for what, moved, present in _joints(metadata, env.unwrapped):
        if moved != present:
            yield f"{what}: the policy moves {', '.join(moved)}; the environment has {', '.join(present)}"


def _group_mismatches(wanted: list[ObservationGroupInfo], env: RslRlVecEnvWrapper) -> Iterator[str]:
    obs = env.get_observations()
    there = {name: tuple(value.shape[1:]) for name, value in obs.items() if isinstance(value, torch.Tensor)}
    shapes = {group["name"]: there[group["name"]] for group in wanted if group["name"] in there}
    present = {group["name"]: group for group in observation_groups(env.unwrapped, shapes)}
    for group in wanted:
        name, here = group["name"], present.get(group["name"])
        if here is None:
            yield f"observations '{name}': the environment has no such group, but {', '.join(there)}"
            continue
        policy_terms, env_terms = _sizes(group["terms"]), _sizes(here["terms"])
        if policy_terms is not None and env_terms is not None and policy_terms != env_terms:
            yield _different_groups(name, _listed(policy_terms), _listed(env_terms))
        elif tuple(group["shape"]) != tuple(here["shape"]):
            yield _different_groups(name, tuple(group["shape"]), tuple(here["shape"]))


def _different_groups(name: str, policy: object, env: object) -> str:
    return f"observations '{name}': the policy reads {policy}; the environment has {env}"


def _joints(metadata: PolicyMetadata, env: TorchVectorEnv) -> Iterator[tuple[str, list[str], list[str]]]:
    """Joints that are moved: what they are called, the policy's, and the environment's.

    They are those of the action terms, or those of whole assets where either side has no action terms.
    """
    assets = articulations(env)
    policy_terms, env_terms = metadata["actions"]["terms"], action_terms(env, assets)
    if policy_terms is not None and env_terms is not None:
        yield (
            "joints",
            [joint for term in policy_terms for joint in term.get("joint_names", ())],
            [joint for term in env_terms for joint in term.get("joint_names", ())],
        )
        return
    for name, asset in metadata["assets"].items():
        if name in assets:
            yield f"joints of '{name}'", asset["joint_names"], assets[name]["joint_names"]


def _sizes(terms: list[ObservationTermInfo] | None) -> list[tuple[str, int]] | None:
    """Names and sizes of terms, histories included."""
    return None if terms is None else [(t["name"], t["size"] * max(1, t["history_length"])) for t in terms]


def _listed(sizes: list[tuple[str, int]]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in sizes)
