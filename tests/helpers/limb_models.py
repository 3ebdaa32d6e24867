# SPDX-License-Identifier: Apache-2.0
"""Models of a hub with limbs, for the tests of the form of the fused step for them."""

from __future__ import annotations

import mujoco
import newton
import numpy as np

from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.static_meshes import MUST, add_triangles_attribute

OPTION = '<compiler angle="radian"/><option timestep="0.005" integrator="{integrator}"/>'
PLANE = '<geom type="plane" size="0 0 1" euler=".09 .05 0" condim="1" contype="1" conaffinity="2"/>'
GROUND = f'<body pos="0.1 0 0">{PLANE}</body>'
POSTS = """<body pos=".3 .1 0"><geom type="capsule" fromto="0 0 -.2 .1 0 .4" size=".06" contype="1" conaffinity="2"/>
<body pos="-.5 -.2 0"><geom size=".12" contype="1" conaffinity="2"/></body></body>
<geom type="box" pos="0 -.25 .05" euler=".2 .1 .3" size=".15 .1 .1" contype="1" conaffinity="2" condim="3"/>"""
"""What stands about: in bodies of their own and of the world."""
FIELD = '<geom type="hfield" hfield="hills" contype="1" conaffinity="2"/>'
HILLS = '<asset><hfield name="hills" nrow="20" ncol="24" size="1.2 1 .12 .1" elevation="{}"/></asset>'
MESHES = """<geom type="box" pos="0 0 -.2" euler=".03 .05 0" size="2 2 .2" contype="1" conaffinity="2" condim="1"/>
<geom type="box" pos="0 -.25 .02" euler=".2 .1 .3" size=".15 .1 .1" contype="1" conaffinity="2" friction=".3"/>
<geom type="cylinder" pos=".3 .1 0" euler="1.2 0 0" size=".1 .2" contype="1" conaffinity="2" friction=".7"/>"""
"""What is touched by its triangles, see :func:`walker_worlds`."""
LEG = """<body pos="{x} {y} 0"><joint axis="1 0 0" range="-.6 .6" limited="true" damping=".1" armature=".01"/>
<joint axis="0 1 0.1" pos="0 0 .01" range="-1 .3" limited="true" margin=".02" damping=".1" armature=".01" name="{n}a"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".03"/><body pos="0 0 -.25" euler="0 .17 0" gravcomp="0.5">
<joint axis="0 1 0" stiffness="2" springref=".2" {loss} name="{n}b" actuatorfrcrange="-1 1"/>
<geom type="capsule" fromto="0 0 0 0.05 0 -.2" size=".02" condim="3"/>
<body pos=".05 0 -.2"><geom type="sphere" size=".03" mass=".1" condim="3" friction=".6"/></body></body></body>"""
ARM_SHAPE = '<geom type="cylinder" size=".03 .08"/>'
ARM = f"""<body pos="0 {{y}} .1"><joint axis="0 0 1" type="slide" range="-.1 .1" limited="true" name="{{n}}c"
armature=".1"/>{ARM_SHAPE}</body>"""
TRUNK = '<geom type="box" size=".2 .1 .05" density="500"/>'
DRIVES = """<actuator><position joint="la" kp="20" kv="1" ctrlrange="-.5 .5"/>
<motor joint="lb" gear="3" forcerange="-.4 .4"/><position joint="rc" kp="50" kv="3"/>
<velocity joint="rb" kv=".5"/><motor joint="rb" gear=".5"/></actuator>"""
WALKERS = {
    # A trunk of two parts, each with limbs; something welded to it.
    "floating": (
        f"<body pos='0 0 .45'><freejoint/>{TRUNK}<body pos='.2 0 0'><geom size='.06'/></body>"
        + ARM.format(n="l", y=0.15) + ARM.format(n="r", y=-0.15)
        + "<body pos='0 0 -.1'><joint axis='0 0 1' range='-.5 .5' limited='true' armature='.02' damping='.2'/>"
        "<joint axis='0 1 0' range='-.2 .2' limited='true' armature='.02' stiffness='5'/>"
        "<geom type='capsule' fromto='0 -.1 0 0 .1 0' size='.05'/>"
        + LEG.format(n="l", x=0, y=0.1, loss="") + LEG.format(n="r", x=0, y=-0.1, loss="") + "</body></body>"
    ),
    "with friction loss": (
        f"<body pos='0 0 .45'><freejoint/>{TRUNK}" + ARM.format(n="r", y=-0.15)
        + LEG.format(n="l", x=0.2, y=0.1, loss='frictionloss=".1"')
        + LEG.format(n="r", x=-0.2, y=-0.1, loss='frictionloss=".2"') + "</body>"
    ),
    # In a plane: the root has three joints, of which one has friction loss and one a limit.
    "planar": (
        "<body pos='0 0 .45'><joint type='slide' axis='1 0 0' frictionloss='.5'/><joint type='slide' axis='0 0 1' "
        f"range='-.3 .5' limited='true'/><joint axis='0 1 0' pos='0 0 .02' damping='.1'/>{TRUNK}"
        + ARM.format(n="r", y=-0.15) + LEG.format(n="l", x=0.2, y=0, loss="") + LEG.format(n="r", x=-0.2, y=0, loss="")
        + "</body>"
    ),
    # 36 degrees of freedom, more than the lanes of a warp.
    "many legs": (
        f"<body pos='0 0 .45'><freejoint/>{TRUNK}"
        + "".join(LEG.format(n=f"{'lr'[i % 2]}{i // 2 or ''}", x=i // 2 * 0.12 - 0.2, y=0.1 - 0.2 * (i % 2), loss="")
                  for i in range(10))
        + ARM.format(n="r", y=-0.15) + "</body>"
    ),
    # Limbs of what does not move.
    "hanging": (
        f"<body pos='0 0 .4' euler='.17 0 0'>{TRUNK}" + ARM.format(n="r", y=-0.15)
        + LEG.format(n="l", x=0.2, y=0.1, loss="") + LEG.format(n="r", x=-0.2, y=-0.1, loss="") + "</body>"
    ),
}  # fmt: skip
"""Bodies of models."""


def walker_xml(name: str, integrator: str = "implicitfast", replaced: tuple[str, str] = ("", "")) -> str:
    """Description of a model by its name in :data:`WALKERS`. Only the ground touches its parts."""
    contacts = '<default><geom contype="2" conaffinity="1"/></default>'
    option = OPTION.format(integrator=integrator)
    hills = HILLS.format(" ".join(f"{x:.4f}" for x in np.random.default_rng(0).random(20 * 24)))
    text = f"<mujoco>{option}{contacts}{hills}<worldbody>{GROUND}{WALKERS[name]}</worldbody>{DRIVES}</mujoco>"
    assert replaced[0] in text
    return text.replace(*replaced) if replaced[0] else text


def walker(name: str, integrator: str = "implicitfast", replaced: tuple[str, str] = ("", "")) -> mujoco.MjModel:
    """The model, with some text of its description ``replaced`` by other."""
    return mujoco.MjModel.from_xml_string(walker_xml(name, integrator, replaced))


def walker_worlds(name: str, num_worlds: int, ground: str = PLANE, device: str = "cpu") -> newton.Model:
    """Worlds of a Newton model, which has planes and fields in no body; :data:`MESHES` are touched by triangles."""
    one, scene = newton.ModelBuilder(), newton.ModelBuilder()
    for each in (one, scene):
        SolverFused.register_custom_attributes(each)
        add_triangles_attribute(each)
    text = walker_xml(name, replaced=(GROUND, ground))
    if ground == MESHES:
        text = text.replace(ARM_SHAPE, ARM_SHAPE.replace("cylinder", "capsule"))
    one.add_mjcf(text)
    if ground == MESHES:
        static = [shape for shape, body in enumerate(one.shape_body) if body < 0]
        one.custom_attributes["stripe:triangles"].values.update(dict.fromkeys(static, MUST))
    scene.replicate(one, num_worlds)
    return scene.finalize(device=device)
