# SPDX-License-Identifier: Apache-2.0
"""Models for the tests of the fused solver: trees with all kinds of joints, primitives, and worlds of Newton models."""

from __future__ import annotations

import mujoco
import newton
import numpy as np
import pytest

from stripe_newton.solvers import SolverFused, contact_pairs

ROOM = {"njmax": 60, "nconmax": 20, "kinematic_switchable_roots": False}
"""Arguments of a solver for these worlds."""
SCENE = """<mujoco><option timestep="0.005" {option}/><worldbody><geom type="plane" size="0 0 1" euler="5 3 0"
conaffinity="3"/>{bodies}</worldbody>{rest}</mujoco>"""
TREE = """<body pos="0 0 0.3"><freejoint/><geom type="box" size=".2 .1 .05" density="500"/>
<body pos=".2 .1 0"><joint axis="0 1 0" range="-1 1" limited="true" damping=".1" armature=".01" name="a"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".03"/><body pos="0 0 -.25" gravcomp="0.5">
<joint axis="0 1 0" stiffness="2" springref=".2" frictionloss=".1" name="b" actuatorfrcrange="-1 1"/>
<geom type="capsule" fromto="0 0 0 0.05 0 -.2" size=".02"/></body></body>
<body pos="-.2 -.1 0"><joint type="ball" damping=".02" range="0 1" limited="true"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".03"/><body pos="0 0 -.25">
<joint type="slide" axis="0 0 1" range="-.1 .1" limited="true" name="c" armature=".1"/>
<joint axis="1 0 0" name="d" armature=".01"/>
<geom type="sphere" size=".03"/></body></body></body>"""
DRIVES = """<tendon><fixed name="t"><joint joint="c" coef=".5"/><joint joint="d" coef="2"/></fixed></tendon>
<equality><joint joint1="a" joint2="b" polycoef=".1 .5 .2 0 .1"/></equality><actuator>
<position joint="a" kp="20" kv="1" ctrlrange="-.5 .5"/><motor joint="b" gear="3" forcerange="-.4 .4"/>
<position tendon="t" kp="5" kv=".3"/><velocity joint="d" kv=".5"/></actuator>"""


def primitives() -> str:
    """Ten free bodies of three shapes, with all sizes of contacts, priorities and margins; cylinders touch planes."""
    rng, lines = np.random.default_rng(0), []
    shapes = ('type="sphere" size=".1"', 'type="capsule" size=".05 .1"', 'type="cylinder" size=".08 .07"')
    for i in range(10):
        x, y = rng.uniform(-0.35, 0.35, 2)
        only_plane = ' contype="2" conaffinity="0"' if i % 3 == 2 else ""
        lines.append(
            f'<body pos="{x} {y} {0.15 + 0.12 * i}"><freejoint/><geom {shapes[i % 3]}{only_plane} '
            f'condim="{(1, 3, 4, 6)[i % 4]}" friction="{rng.uniform(0.3, 1.0)} .01 .001" priority="{i % 2}" '
            f'margin="{0.01 * (i % 3)}"/></body>'
        )
    return "".join(lines)


def boxes() -> str:
    """Boxes and spheres, of which those of one kind pass through each other."""
    kinds = ('type="sphere" contype="2" conaffinity="1"', 'type="box" contype="1" conaffinity="2"')
    place = "<body pos='{} {} .15'><freejoint/><geom {} size='.1 .08 .06'/></body>"
    return "".join(place.format(0.3 * (i % 3), 0.3 * (i // 3), kinds[i % 2]) for i in range(9))


MODELS = {
    "tree, implicitfast": (TREE, 'integrator="implicitfast"', DRIVES, True),
    "tree, Euler, elliptic": (TREE, 'integrator="Euler" cone="elliptic" impratio="3"', DRIVES, True),
    "primitives": (primitives(), 'integrator="implicitfast"', "", False),
    "primitives, elliptic": (primitives(), 'cone="elliptic" integrator="implicitfast"', "", False),
    "boxes": (boxes(), "", "", False),
}
"""Bodies, options, actuators, and whether contacts are those of MuJoCo rather than found by the kernel."""


def model_of(name: str) -> tuple[mujoco.MjModel, bool]:
    bodies, option, rest, given = MODELS[name]
    return mujoco.MjModel.from_xml_string(SCENE.format(bodies=bodies, option=option, rest=rest)), given


def chain(num_worlds: int) -> newton.Model:
    """Worlds with a chain of four spheres above a plane."""
    link = "<body pos='.4 0 0'><joint axis='0 1 0' damping='.1'/><geom type='sphere' size='.1'/>"
    return replicated(
        "<body pos='0 0 .4'><freejoint/><geom type='sphere' size='.1'/>" + 3 * link + "</body>" * 4, num_worlds
    )


def replicated(bodies: str, num_worlds: int) -> newton.Model:
    """Worlds with bodies above a plane."""
    one = newton.ModelBuilder()
    SolverFused.register_custom_attributes(one)
    one.rigid_gap = 0.0
    one.add_mjcf(f"<mujoco><worldbody><geom type='plane' size='0 0 1'/>{bodies}</worldbody></mujoco>")
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    builder.replicate(one, num_worlds)
    return builder.finalize(device="cpu")


def leave_curved_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pairs of cylinders and ellipsoids to MuJoCo Warp's collision detection, as others that have no routine."""
    kinds = {key: kind for key, kind in contact_pairs.KINDS.items() if not contact_pairs.is_curved(kind)}
    monkeypatch.setattr(contact_pairs, "KINDS", kinds)


def tower_and_ball(top: str, num_worlds: int) -> newton.Model:
    """Worlds with a box, a box or an ellipsoid on it, and a ball on the ground."""
    place = "<body pos='{} 0 {}'><freejoint/><geom type='{}' size='.1 .1 .1'/></body>"
    places = (0.0, 0.099, "box"), (0.03, 0.297, top), (0.4, 0.2, "sphere")
    return replicated("".join(place.format(*at) for at in places), num_worlds)
