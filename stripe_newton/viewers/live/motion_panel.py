# SPDX-License-Identifier: Apache-2.0
"""Motion panel: a choice among recorded motions, and a slider for the time within the chosen one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING

from .inbox import Inbox

if TYPE_CHECKING:
    import viser

__all__ = ["MotionPanel"]

_SLIDES_PER_S = 10.0
"""Most updates of the slider in a second of a motion: each is a message to the browser."""
_RESOLUTION = 0.01
"""Step of the slider [s]. That of a frame would be shown with six digits."""


class MotionPanel:
    """Goes through the frames of motions, one motion after the other, and where the slider says.

    Args:
        gui: Where the inputs go.
        inbox: Carries changes to the simulation's thread.
        names: Names of the motions.
        lengths: Numbers of their frames.
        fps: Frames a second.
        pose: Puts the robot at a frame, counted over all motions.
        tell: Shows lines of text by name, such as :meth:`LiveViewer.set_status`.
        order: Place of the inputs on the page.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        inbox: Inbox,
        names: Sequence[str],
        lengths: Sequence[int],
        fps: float,
        pose: Callable[[int], None],
        tell: Callable[[Mapping[str, str]], None],
        order: float | None = None,
    ):
        self._inbox, self._fps, self._pose, self._tell = inbox, fps, pose, tell
        labels = list(names) if len(set(names)) == len(names) else [f"{i + 1}: {n}" for i, n in enumerate(names)]
        self._lengths = dict(zip(labels, lengths, strict=True))
        self._starts = dict(zip(labels, accumulate(lengths, initial=0), strict=False))
        self._label, self._index = labels[0], 0
        with gui.add_folder("Motion", order=order):
            self.choice = gui.add_dropdown("Motion", labels, initial_value=labels[0], visible=len(labels) > 1)
            self.slider = gui.add_slider("Time [s]", 0.0, self._duration(), _RESOLUTION, 0.0)
        inbox.on_change(self.choice, self.choose)
        inbox.on_change(self.slider, self.seek)
        self._show(0)

    @property
    def frame(self) -> int:
        """The frame that is shown, within its motion."""
        return self._index - self._starts[self._label]

    def advance(self) -> None:
        """Show the next frame; that of the next motion after the last one, and in the end of the first."""
        if self.frame + 1 < self._lengths[self._label]:
            self._show(self._index + 1)
        else:
            labels = list(self._lengths)
            self.choose(labels[(labels.index(self._label) + 1) % len(labels)])
        if self.frame % max(1, round(self._fps / _SLIDES_PER_S)) == 0:
            self._inbox.set_quietly(self.slider, round(self.frame / self._fps, 2))

    def choose(self, label: str) -> None:
        """Begin a motion, by its name in :attr:`choice`."""
        self._label = label
        self._inbox.set_quietly(self.choice, label)
        self._inbox.set_quietly(self.slider, 0.0)  # before its end may move below where it is
        self.slider.max = self._duration()
        self._show(self._starts[label])

    def seek(self, seconds: float) -> None:
        """Show the frame at a time of the motion."""
        frame = min(max(round(seconds * self._fps), 0), self._lengths[self._label] - 1)
        self._show(self._starts[self._label] + frame)

    def _show(self, index: int) -> None:
        self._index = index
        self._pose(index)
        last = self._lengths[self._label] - 1
        seconds = f"{self.frame / self._fps:.2f} of {last / self._fps:.2f} s"
        self._tell({"motion": self._label, "frame": f"{self.frame} of {last}, {seconds}"})

    def _duration(self) -> float:
        """Duration of the motion [s]; a motion of one frame has a slider that cannot move."""
        return max(round((self._lengths[self._label] - 1) / self._fps, 2), _RESOLUTION)
