# SPDX-License-Identifier: Apache-2.0
"""Checkpoint panel: switches the policy that acts while the live view runs, and takes the newest one by itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from .inbox import Inbox

if TYPE_CHECKING:
    import viser

__all__ = ["CheckpointPanel", "Checkpoints"]

_EVERY = 2.0
"""Time between two looks for new checkpoints [s]."""


class Checkpoints(Protocol):
    """Checkpoints of a policy, such as those of a run folder into which a training writes."""

    current: str
    """Name of the one that acts."""

    def names(self) -> list[str]:
        """Names of all that are there now, the newest last."""

    def load(self, name: str) -> None:
        """Let a checkpoint act from the next step on.

        Raises:
            Exception: if it cannot be read; the one before then goes on.
        """


class CheckpointPanel:
    """A choice of checkpoints.

    Args:
        gui: Where the inputs go.
        inbox: Carries changes to the simulation's thread.
        checkpoints: The checkpoints.
        loaded: Called after another one was loaded.
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, checkpoints: Checkpoints, loaded: Callable[[], None]):
        self._inbox, self._checkpoints, self._loaded = inbox, checkpoints, loaded
        names = checkpoints.names()
        self._bad: set[str] = set()
        """Checkpoints that could not be loaded, which are not tried again by themselves."""
        self._next = 0.0
        with gui.add_folder("Policy"):
            self.choice = gui.add_dropdown(
                "Checkpoint", _options(names, checkpoints.current), initial_value=checkpoints.current
            )
            self.newest = gui.add_checkbox(
                "Newest", names[-1:] == [checkpoints.current], hint="Take a new checkpoint as soon as it is written"
            )
        inbox.on_change(self.choice, self._choose)
        inbox.on_change(self.newest, lambda _: self.update(at_once=True))

    def update(self, at_once: bool = False) -> None:
        """Look for new checkpoints now and then, and take the newest if it is wanted."""
        now = time.monotonic()
        if now < self._next and not at_once:
            return
        self._next = now + _EVERY
        names = self._checkpoints.names()
        if (options := _options(names, self._checkpoints.current)) != tuple(self.choice.options):
            chosen = self.choice.value
            self.choice.options = options
            self._inbox.set_quietly(self.choice, chosen if chosen in options else self._checkpoints.current)
        fresh = [name for name in names if name not in self._bad]
        if self.newest.value and fresh and fresh[-1] != self._checkpoints.current:
            self._load(fresh[-1])

    def _choose(self, name: str) -> None:
        """Load what somebody has chosen; the newest is then no longer taken by itself, unless it is that."""
        names = self._checkpoints.names()
        self._inbox.set_quietly(self.newest, names[-1:] == [name])
        self._bad.discard(name)
        if name != self._checkpoints.current:
            self._load(name)

    def _load(self, name: str) -> None:
        try:
            self._checkpoints.load(name)
        except Exception as error:  # such as a file that is not whole, or of other networks
            self._bad.add(name)
            self._inbox.tell(f"checkpoint {name}", error)
        else:
            self._loaded()
        self._inbox.set_quietly(self.choice, self._checkpoints.current)


def _options(names: list[str], current: str) -> tuple[str, ...]:
    """The newest first, with the one that acts, also if its file is gone."""
    return tuple(reversed(names if current in names else [current, *names]))
