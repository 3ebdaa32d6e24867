# SPDX-License-Identifier: Apache-2.0
"""Hooks of the physics: when they run, and in which order."""

from __future__ import annotations

import newton
import pytest

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import PhysicsHook
from tests.helpers.ray_world import body
from tests.helpers.small_scenes import make_scene


class Recorder(PhysicsHook):
    """Writes down what runs."""

    def __init__(self, name: str, events: list[str]):
        self.name, self.events, self.lost = name, events, ""

    def launch_before_steps(self) -> None:
        self.events.append(f"{self.name}: before steps")

    def launch_after_step(self) -> None:
        self.events.append(f"{self.name}: after step")

    def launch_after_notify(self) -> None:
        self.events.append(f"{self.name}: after notify")

    def report_overflow(self) -> str:
        lost, self.lost = self.lost, ""
        return lost


@pytest.fixture
def scene() -> InteractiveScene:
    return make_scene({"body": body()}, num_envs=1)


def test_hooks_run_around_the_physics_in_the_order_in_which_they_were_added(scene):
    events: list[str] = []
    for name in ("one", "two"):
        scene.sim.add_hook(Recorder(name, events))
    scene.sim.launch(2, before_each=lambda: events.append("before each"))
    each = ["before each", "one: after step", "two: after step"]
    assert events == ["one: before steps", "two: before steps", *each, *each]


def test_hooks_run_after_the_solver_was_told_of_changes(scene):
    events: list[str] = []
    scene.sim.add_hook(Recorder("one", events))
    scene.sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)
    assert events == ["one: after notify"]


def test_a_hook_that_reports_an_overflow_stops_the_next_step_once(scene):
    hook = Recorder("one", [])
    scene.sim.add_hook(hook)
    hook.lost = "slots is 2, set slots=3"
    with pytest.raises(RuntimeError, match="slots is 2, set slots=3"):
        scene.sim.step()
    scene.sim.step()


def test_a_hook_that_overrides_nothing_changes_nothing(scene):
    scene.sim.add_hook(PhysicsHook())
    scene.sim.step(2)
    assert float(scene["body"].data.root_lin_vel_w[0, 2]) == pytest.approx(-2 * 9.81 * scene.sim.physics_dt, rel=1e-4)
