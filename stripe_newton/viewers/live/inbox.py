# SPDX-License-Identifier: Apache-2.0
"""Inbox: carries clicks and changes from the web server's threads to the thread of the simulation."""

from __future__ import annotations

import queue
import sys
import threading
import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import viser

    T = TypeVar("T")

__all__ = ["Inbox"]


class Inbox:
    """Actions that wait for the simulation's thread.

    The web server calls handlers on threads of its own, in the middle of a step. None of them touches the simulation:
    they only put an action here, and :meth:`run` does it between two steps.
    """

    def __init__(self) -> None:
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._here = threading.local()
        self.problems: list[str] = []
        """Errors of actions that nobody has been told yet."""

    def put(self, action: Callable[[], None]) -> None:
        """Let an action wait; from any thread."""
        self._actions.put(action)

    def on_change(self, handle: viser.GuiInputHandle[T], action: Callable[[T], None]) -> None:
        """Do something with the value of an input whenever it has changed, unless by :meth:`set_quietly`."""

        def changed(_: object) -> None:
            if not getattr(self._here, "is_quiet", False):
                # The value of then rather than of now: of many changes of a slider only the last one counts.
                self.put(lambda: action(handle.value))

        handle.on_update(changed)

    def on_click(self, handle: viser.GuiButtonHandle, action: Callable[[], None]) -> None:
        """Do something whenever a button is clicked."""
        handle.on_click(lambda _: self.put(action))

    def on_choice(self, handle: viser.GuiButtonGroupHandle, action: Callable[[str], None]) -> None:
        """Do something with the name of a button of a group whenever one is clicked."""

        def clicked(_: object) -> None:
            name = handle.value
            self.put(lambda: action(name))

        handle.on_click(clicked)

    def on_key(self, handle: viser.CommandHandle, action: Callable[[], None]) -> None:
        """Do something whenever a key is pressed."""
        handle.on_trigger(lambda _: self.put(action))

    def set_quietly(self, handle: viser.GuiInputHandle[T], value: T) -> None:
        """Show a value in an input without the action of a change."""
        self._here.is_quiet = True
        try:
            handle.value = value
        finally:
            self._here.is_quiet = False

    def run(self) -> None:
        """Do what waits, on the calling thread. An error ends neither the viewer nor what it shows."""
        while True:
            try:
                action = self._actions.get_nowait()
            except queue.Empty:
                return
            try:
                action()
            except Exception as error:  # whatever a panel does wrong, hours of training must not end by it
                self.tell("an input", error)

    def tell(self, where: str, error: Exception) -> None:
        """Print an error, and keep it for those who look at the page."""
        traceback.print_exception(error, file=sys.stderr)
        self.problems.append(f"{where}: {type(error).__name__}: {error}")
