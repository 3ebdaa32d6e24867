# SPDX-License-Identifier: Apache-2.0
"""Finite state: the step that makes a scene without an environment not finite says so."""

from __future__ import annotations

import math

import pytest

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.usd import StageError
from tests.helpers.usd_stages import body_text, joint_text, usda


def scene_of(text: str, num_envs: int = 2, **settings) -> InteractiveScene:
    cfg = SimulationCfg(gravity=None, device="cpu", **settings)
    with pytest.warns(UserWarning, match="left out"):
        return InteractiveScene.from_usd(usda(text), num_envs, 3.0, sim_cfg=cfg)


def test_the_step_that_makes_it_so_names_environment_and_joint():
    scene = scene_of(joint_text())
    scene.sim.step(5)
    dof = scene.sim.template.joint_qd_start[scene.sim.template.joint_label.index("/j")]
    scene.sim.per_env(scene.sim.state.joint_qd)[1, dof] = math.nan
    with pytest.raises(FloatingPointError, match=r"environment 1: .* is not finite after a physics step"):
        scene.sim.step(1)


def test_it_is_told_once():
    scene = scene_of(joint_text())
    scene.sim.state.joint_q.fill_(math.inf)
    with pytest.raises(FloatingPointError, match="environment 0"):
        scene.sim.step(1)
    scene.sim.state.assign(scene.sim.model.state())
    scene.sim.clear_solver(scene.controller.mask(None))
    scene.sim.step(3)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ("float physics:mass = 1e-20", "are the units right"),
        ("float physics:mass = 1\nfloat3 physics:diagonalInertia = (1e-20, 1e-20, 1e-20)", "are the units right"),
    ],
)
def test_what_the_solver_does_not_take_is_refused_before(attributes, words):
    with pytest.raises(StageError, match=words) as caught:
        InteractiveScene.from_usd(usda(body_text(attributes)), sim_cfg=SimulationCfg(device="cpu"))
    assert caught.value.prim == "/A"


def test_what_the_solver_says_is_one_error_with_the_prim(monkeypatch):
    from stripe_newton.sim import MuJoCoSolverCfg

    def refuse(self, *args):
        raise ValueError("Error: no such thing\nElement name '_A_shape', id 0")

    monkeypatch.setattr(MuJoCoSolverCfg, "_create", refuse)
    with pytest.raises(StageError, match="the solver does not take it: Error: no such thing Element name") as caught:
        InteractiveScene.from_usd(usda(body_text()), sim_cfg=SimulationCfg(device="cpu"))
    assert caught.value.prim == "/A/shape"
