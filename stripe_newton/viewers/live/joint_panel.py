# SPDX-License-Identifier: Apache-2.0
"""Joint panel: sliders that move the joints of what stands still, such as a robot that is inspected."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import newton
import numpy as np

from .inbox import Inbox

if TYPE_CHECKING:
    import viser

__all__ = ["JointPanel"]

_MOST = 80
"""Most joints that get a slider."""
_SPREAD = {int(newton.JointType.REVOLUTE): math.pi, int(newton.JointType.PRISMATIC): 1.0}
"""Kinds of joints that get a slider, and half the range of those without limits [rad, m]."""


class JointPanel:
    """A slider for each hinge and slide of the first environment.

    Args:
        gui: Where the sliders go.
        inbox: Carries changes to the simulation's thread.
        sim: A :class:`Simulation` that nothing steps.
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, sim: Any):
        self._sim = sim
        self.sliders: dict[str, viser.GuiSliderHandle] = {}
        """Sliders by the label of the joint."""
        template, model = sim.template, sim.model
        starts, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
        lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
        positions = sim.state.joint_q.numpy()
        for joint, (kind, label) in enumerate(zip(template.joint_type, template.joint_label)):
            if int(kind) not in _SPREAD or len(self.sliders) == _MOST:
                continue
            spread, place = _SPREAD[int(kind)], int(starts[joint])
            bounds = (float(limits[int(dofs[joint])]) for limits in (lower, upper))
            low, high = (b if abs(b) < 100.0 else math.copysign(spread, b) for b in bounds)
            if not low < high:
                continue
            low, high = round(low, 3), round(high, 3)
            value = min(max(round(float(positions[place]), 3), low), high)
            slider = gui.add_slider(str(label).rpartition("/")[2], low, high, 0.001, initial_value=value)
            inbox.on_change(slider, partial(self._move, place))
            self.sliders[str(label)] = slider

    def _move(self, place: int, value: float) -> None:
        """Put a joint at a position, and all bodies to where the joints have them."""
        positions = np.array(self._sim.state.joint_q.numpy())
        positions[place] = value
        self._sim.state.joint_q.assign(positions)
        self._sim.forward()
