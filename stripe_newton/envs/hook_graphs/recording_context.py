# SPDX-License-Identifier: Apache-2.0
"""Recording context: what all recorded hooks of an environment share, and what one leaves for the host."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import torch

from .carried_state import CarriedState
from .extras import Extras, memory_like, publish_extras
from .snapshot import Snapshot

__all__ = ["HookGraph", "HooksEnv", "Launched", "RecordingContext", "set_flags"]


Flag: TypeAlias = tuple[object, str, object]
"""A flag of the framework: its holder, name and value."""


class HookGraph(Protocol):
    """Launches of a function, to be replayed on the same memory."""

    def replay(self) -> None:
        """Launch it again."""
        ...


class HooksEnv(Protocol):
    """An environment with torch hooks."""

    extras: dict[str, Any]
    device: str


@dataclass
class RecordingContext:
    """State that all hooks of an environment share.

    Attributes:
        env: The environment.
        skip: Attributes that belong to the framework and are not state of the hooks.
        arrays: Returns the memory of the simulation that hooks may write, by name.
        record: Makes the graph of a function.
        waits: Context within which a wait of the host for the device raises.
        flags: Holder and name of the framework's own flags that a hook may set.
        carried: Homes of the tensors, once all hooks are traced.
        fused_envs: Number of environments, whose rows fused kernels compute; 0 to fuse nothing.
        log_memory: Makes memory like a tensor of the log, outside of recordings.
    """

    env: HooksEnv
    skip: Collection[str]
    arrays: Callable[[], Mapping[str, torch.Tensor]]
    record: Callable[[Callable[[], None]], HookGraph]
    waits: Callable[[], Any]
    flags: list[tuple[object, str]] = field(default_factory=list)
    carried: CarriedState | None = None
    fused_envs: int = 0
    log_memory: Callable[[torch.Tensor], torch.Tensor] = memory_like

    def snapshot(self) -> Snapshot:
        """Copy of all that hooks can change."""
        return Snapshot(self.env, self.skip, self.arrays(), self.env.device)

    def flag_values(self) -> list[Flag]:
        """The framework's flags as they are now."""
        return [(holder, name, getattr(holder, name)) for holder, name in self.flags]


def set_flags(flags: Iterable[Flag]) -> None:
    """Set the framework's flags."""
    for holder, name, value in flags:
        setattr(holder, name, value)


@dataclass
class Launched:
    """The host's part of a recorded hook, for after each replay.

    Attributes:
        env: The environment.
        extras: What the hook adds to the extras, with tensors that each replay overwrites.
        flags: The framework's flags that it sets.
    """

    env: HooksEnv
    extras: Extras
    flags: list[Flag]

    def __call__(self) -> None:
        """Publish the extras and set the flags."""
        publish_extras(self.env.extras, self.extras)
        set_flags(self.flags)

    def parts(self) -> list[Callable[[], None]]:
        """This, for the list of what the host does; an empty list if it does nothing."""
        return [self] if self.extras or self.flags else []

    def log_tensors(self) -> dict[str, torch.Tensor]:
        """Numbers that the hook adds to the episode log, by key, in memory that each replay overwrites."""
        log = self.extras.get("log", {})
        return {k: v for k, v in log.items() if isinstance(v, torch.Tensor) and v.numel() == 1}
