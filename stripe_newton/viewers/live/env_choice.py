# SPDX-License-Identifier: Apache-2.0
"""Environment choice: the environment that panels are about, and those that are shown around it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .inbox import Inbox

if TYPE_CHECKING:
    import viser

__all__ = ["MOST_SHOWN", "EnvChoice"]

MOST_SHOWN = 256
"""Most environments that a browser is given."""
_WAYS = ("this one", "nearest", "group", "all")


class EnvChoice:
    """Inputs for the environments.

    Args:
        gui: Where the inputs go.
        inbox: Carries changes to the simulation's thread.
        origins: Origins of all environments [m], shape ``(num_envs, 3)``.
        shown: Environments that are shown at first; the first of them is the chosen one.
        changed: Called after another choice.
    """

    def __init__(
        self, gui: viser.GuiApi, inbox: Inbox, origins: np.ndarray, shown: list[int], changed: Callable[[], None]
    ):
        self._inbox, self._origins, self._changed = inbox, np.asarray(origins, dtype=float), changed
        count = len(self._origins)
        self._given: list[int] | None = shown
        several = count > 1
        with gui.add_folder("Environments", visible=several):
            self.number = gui.add_slider(
                "Environment", 0, max(count - 1, 1), 1, shown[0], hint="The one that camera, commands and plots are of"
            )
            ways = _WAYS if count <= MOST_SHOWN else _WAYS[:-1]
            start = "all" if len(shown) == count and count <= MOST_SHOWN else "this one" if len(shown) == 1 else "group"
            self.way = gui.add_dropdown(
                "Show", ways, initial_value=start, hint="Around the chosen one: by distance, or by number"
            )
            most = max(min(count, MOST_SHOWN), 2)
            self.count = gui.add_slider("How many", 1, most, 1, min(max(len(shown), 1), most))
        self._show_count()
        inbox.on_change(self.number, lambda _: self._choose())
        inbox.on_change(self.way, lambda _: self._choose())
        inbox.on_change(self.count, lambda _: self._choose())

    @property
    def chosen(self) -> int:
        """The environment that panels are about."""
        return min(int(self.number.value), len(self._origins) - 1)

    @property
    def shown(self) -> list[int]:
        """Environments that are shown, by number; the chosen one is among them."""
        if self._given is not None:
            return self._given
        count, chosen, wanted = len(self._origins), self.chosen, int(self.count.value)
        if self.way.value == "this one":
            return [chosen]
        if self.way.value == "all":
            return list(range(count))
        if self.way.value == "group":
            first = chosen // wanted * wanted
            return list(range(first, min(first + wanted, count)))
        far = np.linalg.norm(self._origins - self._origins[chosen], axis=1)
        far[chosen] = -1.0  # the first, also among environments at one place
        return sorted(int(i) for i in np.argsort(far, kind="stable")[:wanted])

    def _choose(self) -> None:
        self._given = None  # from now on, what the inputs say
        self._show_count()
        self._changed()

    def _show_count(self) -> None:
        self.count.visible = self.way.value in ("nearest", "group")
