# SPDX-License-Identifier: Apache-2.0
"""Roaming bodies: which body of an environment a camera follows."""

from __future__ import annotations

import newton
import pytest

from stripe_newton.viewers.roaming import roaming_body

MJCF = """
<mujoco>
  <worldbody>
    <body name="first" pos="0 0 1">
      {joints}
      <geom type="sphere" size="0.1" mass="1"/>
      <body name="second" pos="0 0 0.5">
        {more}
        <geom type="sphere" size="0.1" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
X, Y, Z = (f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
LIMITED = '<joint type="slide" axis="1 0 0" range="-4 4" limited="true"/>'
HINGE = '<joint type="hinge" axis="0 1 0"/>'


@pytest.mark.parametrize(
    ("joints", "more", "body"),
    [
        ("<freejoint/>", HINGE, 0),
        (X + Z + HINGE, HINGE, 0),  # a planar robot, as the hopper of gymnasium
        (X, Y, 1),  # a planar base as a chain
        (LIMITED, HINGE, None),  # a cart on a rail
        (Z, HINGE, None),  # a lift
        (HINGE, HINGE, None),  # an arm
        (HINGE, X, None),  # a slide of an arm
    ],
)
def test_a_camera_follows_what_may_go_anywhere(joints, more, body):
    builder = newton.ModelBuilder()
    builder.add_mjcf(MJCF.format(joints=joints, more=more))
    assert roaming_body(builder) == body
