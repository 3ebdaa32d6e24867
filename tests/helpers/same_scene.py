# SPDX-License-Identifier: Apache-2.0
"""Same scene: two scenes are compared by their models, names and reports."""

from __future__ import annotations

from stripe_newton.scene import InteractiveScene
from tools.checks.model_arrays import different_arrays


def assert_same(one: InteractiveScene, two: InteractiveScene) -> None:
    """The same model to the last bit, by the same names, and the same report."""
    assert different_arrays(one.sim.model, two.sim.model) == []
    for labels in ("body_label", "joint_label", "shape_label", "articulation_label"):
        assert list(getattr(one.sim.model, labels)) == list(getattr(two.sim.model, labels))
    assert actuator_count(one) == actuator_count(two)
    first, second = one.builder.reports[0], two.builder.reports[0]
    assert first.semantics == second.semantics
    assert first.materials == second.materials[: len(first.materials)]
    assert first.joints == second.joints
    assert first.lights == second.lights


def actuator_count(scene: InteractiveScene) -> int:
    return sum(a.num_actuators for a in scene.sim.model.actuators)
