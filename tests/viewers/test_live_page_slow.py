# SPDX-License-Identifier: Apache-2.0
"""Live page: the live viewer in a real browser, worked by clicks, keys and the mouse."""

from __future__ import annotations

import io

import numpy as np
import pytest

from stripe_newton.viewers import LiveViewer, ViewerCfg
from tests.helpers.viewed_boxes import BoxEnv
from tools.pictures.headless_browser import is_available, open_page

pytest.importorskip("viser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not is_available(), reason="needs playwright and chromium"),
]


class Policies:
    """Checkpoints of a policy that is one number."""

    def __init__(self):
        self.current, self.there = "model_10", ["model_5", "model_10"]

    def names(self):
        return self.there

    def load(self, name):
        self.current = name


class Shown:
    """A viewer of boxes, and the page that shows it."""

    def __init__(self):
        self.env, self.policies = BoxEnv(), Policies()
        cfg = ViewerCfg(eye=(2.2, -2.2, 1.2), lookat=(0.0, 0.0, 0.4))
        self.viewer = LiveViewer(self.env, cfg=cfg, checkpoints=self.policies, title="boxes", port=18600)

    def serve(self):
        """Take a step if the page lets."""
        self.viewer._serve_page()
        if self.viewer.time.takes_step():
            self.env.step()
            self.viewer.after_step()


@pytest.fixture(scope="module")
def shown():
    shown = Shown()
    with shown.viewer, open_page(shown.viewer.url, shown.serve, (1000, 700)) as page:
        shown.page = page
        yield shown


@pytest.fixture(autouse=True)
def running(shown):
    """Each test begins with time that goes on, and new episodes."""
    shown.viewer.time.set_paused(False)
    shown.env.reset()


def picture(shown):
    image = pytest.importorskip("PIL.Image")
    return np.asarray(image.open(io.BytesIO(shown.page.page.screenshot())).convert("RGB")).astype(int)


def test_pause_stops_the_state_and_step_advances_it_by_one(shown):
    page, env = shown.page, shown.env
    page.wait_for(lambda: env.common_step_counter > 0, "steps")
    page.click(page.button("Pause"))
    page.wait_for(lambda: shown.viewer.time.is_paused, "pause")
    before, place = env.common_step_counter, env.box_positions.copy()
    page.wait(1.0)
    assert env.common_step_counter == before
    np.testing.assert_array_equal(env.box_positions, place)
    page.click(page.button("Step"))
    page.wait_for(lambda: env.common_step_counter == before + 1, "one step")
    page.wait(0.5)
    assert env.common_step_counter == before + 1
    np.testing.assert_allclose(env.box_positions[:, 0], place[:, 0] + 0.01, atol=1e-6)
    page.click(page.button("Play"))
    page.wait_for(lambda: env.common_step_counter > before + 5, "time that goes on")


def test_keys_pause_and_step(shown):
    page, env = shown.page, shown.env
    page.page.mouse.click(300, 200)  # beside the panels, so that no field has the keys
    page.page.keyboard.press("p")
    page.wait_for(lambda: shown.viewer.time.is_paused, "pause")
    before = env.common_step_counter
    page.page.keyboard.press("n")
    page.wait_for(lambda: env.common_step_counter == before + 1, "one step")


def test_reset_begins_new_episodes(shown):
    before = shown.env.resets
    shown.page.click(shown.page.button("Reset"))
    shown.page.wait_for(lambda: shown.env.resets == before + 1, "a reset")


def test_the_picture_has_sky_ground_and_the_box(shown):
    page = shown.page
    page.wait(2.0)
    seen = picture(shown)[:, :600]
    red, green, blue = (seen[..., k] for k in range(3))
    assert ((red > 100) & (red > 2 * green) & (red > 2 * blue)).sum() > 500  # the box
    top, bottom = seen[20:60].reshape(-1, 3).mean(axis=0), seen[-120:-40].reshape(-1, 3)
    assert top[2] > top[0] + 5  # the sky is blue
    assert bottom.mean() > 60
    assert bottom.std() > 3.0  # the ground has squares


def test_a_typed_command_reaches_the_environment_and_goes_back_to_the_task(shown):
    page, term = shown.page, shown.env.command_manager.terms["velocity"]
    page.click(page.tab("Act"))
    page.type_number("lin_vel_x", 1.5)
    page.wait_for(lambda: float(term.command[0, 0]) == pytest.approx(1.5), "the command")
    assert float(term.time_left[0]) > 1000.0
    by_hand = page.page.get_by_label("By hand").first
    page.wait_for(by_hand.is_checked, "the checkbox")
    page.click(by_hand)
    page.wait_for(lambda: float(term.time_left[0]) == 0.0, "the task's own command")


def test_dragging_a_body_pushes_it(shown):
    page, env = shown.page, shown.env
    page.click(page.button("Pause"))
    page.wait_for(lambda: shown.viewer.time.is_paused, "pause")
    page.wait(1.5)
    seen = picture(shown)[:, :600]
    red, green, blue = (seen[..., k] for k in range(3))
    rows, columns = np.nonzero((red > 100) & (red > 2 * green) & (red > 2 * blue))
    start = float(np.median(columns)), float(np.median(rows))
    page.drag(start, (start[0], start[1] - 150.0))
    page.wait_for(lambda: shown.viewer.pushes.is_dragging, "a drag")
    height = env.box_positions[0, 2]
    shown.viewer.time.set_paused(False)
    page.wait_for(lambda: env.box_positions[0, 2] > height + 0.1, "the box to rise")
    page.release()
    page.wait_for(lambda: not shown.viewer.pushes.is_dragging, "the end of the drag")
    assert not env.sim.external_wrench.numpy().any()


def test_another_checkpoint_is_chosen_and_the_newest_is_taken_by_itself(shown):
    page, policies = shown.page, shown.policies
    page.click(page.tab("Policy"))
    page.choose("Checkpoint", "model_5")
    page.wait_for(lambda: policies.current == "model_5", "the chosen checkpoint")
    policies.there.append("model_15")
    page.wait(3.0)
    assert policies.current == "model_5"  # what was chosen stays
    page.click(page.page.get_by_label("Newest"))
    page.wait_for(lambda: policies.current == "model_15", "the newest checkpoint")
    policies.there.append("model_20")
    page.wait_for(lambda: policies.current == "model_20", "the next checkpoint")


def test_plots_appear(shown):
    page = shown.page
    page.click(page.tab("Plots"))
    page.wait_for(lambda: page.page.locator(".uplot canvas").count() > 0, "a chart")
    page.click(page.button("One more plot"))
    page.wait_for(lambda: page.page.get_by_text("Plot 3", exact=True).is_visible(), "one more plot")
