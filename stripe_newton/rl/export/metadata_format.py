# SPDX-License-Identifier: Apache-2.0
"""PolicyMetadata: the format of the metadata of an exported policy, as typed dicts of plain values.

``docs/deployment.md`` explains the keys to those who read the file without this package.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, TypedDict

__all__ = [
    "ActionInfo",
    "ActionTermInfo",
    "ArticulationInfo",
    "CheckInfo",
    "CheckResult",
    "NetworkInfo",
    "NetworkInput",
    "NetworkState",
    "ObservationGroupInfo",
    "ObservationTermInfo",
    "Plain",
    "PolicyMetadata",
]

Plain: TypeAlias = "bool | int | float | str | Sequence[Plain] | dict[str, Plain] | None"
"""A value as JSON has it."""


class _NeededOfArticulation(TypedDict):
    joint_names: list[str]


class ArticulationInfo(_NeededOfArticulation, total=False):
    """Joints of an articulation, their gains and limits; lists are in the order of ``joint_names``. Further keys are
    the gains and limits, ``default_root_pos`` and so on."""

    default_joint_pos: list[float]
    default_joint_vel: list[float]


class ActionTermInfo(TypedDict, total=False):
    """An action term. Further keys are what its type needs, such as ``scale`` and ``offset``."""

    name: str
    type: str
    asset: str
    first: int
    size: int
    joint_names: list[str]


class ActionInfo(TypedDict):
    """Actions of the policy."""

    size: int
    clip: float | None
    terms: list[ActionTermInfo] | None


class ObservationTermInfo(TypedDict):
    """A term of an observation group."""

    name: str
    function: str | None
    params: dict[str, Plain]
    first: int
    size: int
    scale: Plain
    clip: Plain
    history_length: int
    history_order: str | None
    modifiers: list[Plain]
    noise: Plain
    delay_steps: list[int]


class _NeededOfGroup(TypedDict):
    name: str
    shape: list[int]
    terms: list[ObservationTermInfo] | None


class ObservationGroupInfo(_NeededOfGroup, total=False):
    """An observation group; ``terms`` is None where the environment has no terms."""

    normalization: dict[str, Plain] | None


class NetworkInput(TypedDict):
    """An input of the network, which may join several observation groups. The first size is ``"batch"``."""

    name: str
    groups: list[str]
    shape: list[str | int]


class NetworkState(TypedDict):
    """A state of a recurrent network: the input that takes it and the output that returns it."""

    input: str
    output: str
    shape: list[str | int]


class NetworkInfo(TypedDict):
    """Inputs, states and outputs of the network, and the normaliser inside it."""

    type: str
    inputs: list[NetworkInput]
    states: list[NetworkState]
    outputs: list[dict[str, Plain]]
    normalizer: dict[str, Plain] | None
    distribution: str | None


class CheckResult(TypedDict):
    """Comparison of one exported network with the policy; no difference where nothing here can run the network."""

    largest_difference: float | None
    by: str


class CheckInfo(TypedDict):
    """Comparison of the exported networks with the policy."""

    tolerance: float
    largest_action: float
    results: dict[str, CheckResult]


class PolicyMetadata(TypedDict):
    """Metadata of an exported policy; each key is a section of the file."""

    format_version: int
    task: str | None
    run: str | None
    iteration: int
    versions: dict[str, str]
    rates: dict[str, Plain]
    solver: dict[str, Plain] | None
    assets: dict[str, ArticulationInfo]
    actions: ActionInfo
    observations: list[ObservationGroupInfo]
    sensors: dict[str, dict[str, Plain]]
    commands: dict[str, dict[str, Plain]]
    network: NetworkInfo
    check: CheckInfo | None
