# SPDX-License-Identifier: Apache-2.0
"""Motion panel: frames one after the other, the choice of a motion, and the slider of its time."""

from __future__ import annotations

import pytest

from stripe_newton.viewers.live.motion_panel import MotionPanel


@pytest.fixture
def shown():
    """The frames that were shown, counted over both motions."""
    return []


@pytest.fixture
def panel(viewer, shown):
    """Two motions, of 3 and of 11 frames."""
    gui, inbox = viewer.server.gui, viewer.inbox
    return MotionPanel(gui, inbox, ["walk", "dance"], [3, 11], 10.0, shown.append, viewer.set_status)


def test_motions_follow_each_other_and_begin_again(panel, shown):
    for _ in range(14):
        panel.advance()
    assert shown == [*range(14), 0]


def test_a_chosen_motion_begins_and_the_slider_reaches_its_end(panel, shown, viewer):
    assert panel.slider.max == pytest.approx(0.2)
    panel.choice.value = "dance"
    viewer.inbox.run()
    assert shown[-1] == 3
    assert panel.slider.max == pytest.approx(1.0)
    panel.slider.value = 0.4
    viewer.inbox.run()
    assert (shown[-1], panel.frame) == (7, 4)
    panel.advance()
    viewer.inbox.run()
    assert (shown[-1], panel.slider.value) == (8, pytest.approx(0.5))


def test_the_slider_does_not_lead_to_frames_of_other_motions(panel, shown):
    panel.seek(9.0)
    assert shown[-1] == 2
    panel.seek(-1.0)
    assert shown[-1] == 0


def test_motions_of_one_name_have_numbers(viewer, shown):
    panel = MotionPanel(
        viewer.server.gui, viewer.inbox, ["a.csv", "a.csv"], [2, 2], 10.0, shown.append, viewer.set_status
    )
    assert list(panel.choice.options) == ["1: a.csv", "2: a.csv"]
    panel.choose("2: a.csv")
    assert shown == [0, 2]
