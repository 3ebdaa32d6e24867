# SPDX-License-Identifier: Apache-2.0
"""Picture parts: pictures of which only a part is traced are those that are traced as a whole."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_newton.viewers.picture_parts import PictureParts
from tests.helpers.viewed_scenes import sim_of

SIZE = (160, 90)
STILL = ViewerCfg(eye=(3.0, -2.0, 1.2), lookat=(0.0, 0.0, 0.4), resolution=SIZE, origin_type="world")


def rod_and_ball():
    """A template of a long box that leans and a ball, each free."""
    template = newton.ModelBuilder()
    rod = template.add_body(xform=wp.transform((0.0, 0.0, 0.6), (0.0, 0.3894, 0.0, 0.9211)), label="/World/Rod/base")
    template.add_shape_box(rod, hx=0.05, hy=0.08, hz=0.5, color=(0.8, 0.3, 0.1))
    ball = template.add_body(xform=wp.transform((0.6, 0.3, 0.3), wp.quat_identity()), label="/World/Ball/base")
    template.add_shape_sphere(ball, radius=0.2, color=(0.1, 0.4, 0.8))
    return template


def both_ways(cfg, num_envs=1, **scene):
    """A simulation, a renderer that traces parts and one that traces whole pictures."""
    sim = sim_of(rod_and_ball(), num_envs=num_envs, **scene)
    parts, whole = (SceneRenderer(sim, cfg, range(num_envs)) for _ in range(2))
    assert parts._tracer._parts is not None
    whole._tracer._parts = None
    return sim, parts, whole


def place(sim, body, position):
    poses = sim.state.body_q.numpy()
    poses[body, :3] = position
    sim.state.body_q.assign(poses)


@pytest.mark.parametrize("cfg", [STILL, ViewerCfg(resolution=SIZE)], ids=["still", "following"])
def test_pictures_are_those_that_are_traced_as_a_whole(cfg):
    sim, parts, whole = both_ways(cfg, num_envs=2)
    places = [
        (1, (0.55, 0.3, 0.3)),
        (1, (0.55, 0.3, 0.3)),  # nothing moves
        (0, (0.1, 0.0, 0.8)),
        (3, (2.9, -1.9, 1.1)),  # around the camera
        (3, (5.0, -4.0, 1.0)),  # behind it
        (1, (0.5, 0.2, -0.05)),  # half in the ground
        (1, (np.nan, 0.0, 0.0)),
        (0, (0.0, 0.0, 6.0)),  # out of the picture, but not its shadow
        (1, (-4.0, 2.0, 0.3)),
    ]
    for body, position in places:
        place(sim, body, position)
        np.testing.assert_array_equal(parts.render(), whole.render(), err_msg=str(position))


def test_in_a_still_picture_little_is_traced_anew():
    sim, parts, _ = both_ways(STILL)
    chosen = []
    choose = parts._tracer._parts.choose
    parts._tracer._parts.choose = lambda view: chosen.append(choose(view)) or chosen[-1]
    parts.render()
    parts.render()
    place(sim, 1, (0.62, 0.3, 0.3))
    parts.render()
    first, again, moved = ([len(part.pixels), len(part.traced), len(part.texels)] for part in chosen)
    assert first[0] == SIZE[0] * SIZE[1]
    assert 0 < first[1] < first[0] / 2  # the ground needs no rays of the sensor
    assert again == [0, 0, 0]
    assert 0 < moved[0] < first[0] / 3
    assert 0 < moved[2] < first[2]


def test_a_picture_changes_with_the_field_of_view():
    _, parts, whole = both_ways(STILL)
    before = parts.render()
    for renderer in (parts, whole):
        renderer.look((3.0, -2.0, 1.2), (0.0, 0.0, 0.4), fov=60.0)
    after = parts.render()
    assert (before != after).any()
    np.testing.assert_array_equal(after, whole.render())


@pytest.mark.parametrize("what", ["height field", "leaning plane"])
def test_what_has_no_box_is_traced_everywhere(what):
    sim = sim_of(rod_and_ball(), ground=False)
    if what == "height field":
        field = newton.Heightfield(data=np.zeros((8, 8), dtype=np.float32), nrow=8, ncol=8, hx=2.0, hy=2.0)
        sim.static.add_shape_heightfield(heightfield=field)
    else:
        sim.static.add_shape_plane(plane=(0.0, 0.6, 0.8, 0.0), width=0.0, length=0.0)
    renderer = SceneRenderer(sim, STILL)
    assert not PictureParts.serves(renderer._scene)
    assert renderer._tracer._parts is None
