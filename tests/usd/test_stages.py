# SPDX-License-Identifier: Apache-2.0
"""Stages of the installed Newton: each steps, or is refused for the reason given here."""

from __future__ import annotations

from pathlib import Path

import newton
import pytest

from stripe_newton.usd.stage_trial import try_stage

PACKAGE = Path(newton.__file__).parent
STAGES = sorted(
    path.relative_to(PACKAGE).as_posix()
    for folder in ("examples/assets", "tests/assets")
    for path in (PACKAGE / folder).rglob("*")
    if path.suffix in (".usd", ".usda", ".usdc", ".usdz")
)
# What does not step, and a part of the reason given. Everything else must step.
VISUAL, SOFT = "no rigid body and no collider", "is deformable or made of particles"
REFUSED = {
    "examples/assets/bear.usd": VISUAL,
    "examples/assets/bunny.usd": VISUAL,
    "examples/assets/crazyflie.usd": VISUAL,
    "examples/assets/curvedSurface.usd": VISUAL,
    "examples/assets/rj45_plug.usd": VISUAL,
    "examples/assets/unisex_shirt.usd": VISUAL,
    "examples/assets/mpm_sand.usda": SOFT,
    "tests/assets/deformables_mixed.usda": SOFT,
    "tests/assets/mpm_material_subsets.usda": SOFT,
    "tests/assets/mpm_two_prims.usda": SOFT,
    "tests/assets/tetmesh_custom_attrs.usda": SOFT,
    "tests/assets/tetmesh_multi.usda": SOFT,
    "tests/assets/tetmesh_simple.usda": SOFT,
    "tests/assets/tetmesh_with_legacy_material.usda": SOFT,
    "tests/assets/tetmesh_with_material.usda": SOFT,
}
HEAVY = {"tests/assets/ant_multi.usda"}


def test_the_table_names_only_stages_that_are_there():
    assert STAGES, "no stage found in the installed newton"
    assert not set(REFUSED) - set(STAGES)
    assert not HEAVY - set(STAGES)


@pytest.mark.parametrize("stage", [pytest.param(s, marks=pytest.mark.slow) if s in HEAVY else s for s in STAGES])
def test_stage_of_newton_steps_or_is_refused(stage: str):
    trial = try_stage(PACKAGE / stage, steps=20)  # the tool that writes the table takes 200
    if stage in REFUSED:
        assert (trial.outcome, REFUSED[stage] in trial.reason) == ("refused", True), trial
    else:
        assert trial.outcome == "steps", trial
        assert trial.bodies > 0
        assert trial.mistake < 1e-5
