# SPDX-License-Identifier: Apache-2.0
"""Markers of a subclass: made by ``_set_debug_vis_impl``, moved by ``_debug_vis_callback`` before each picture."""

import numpy as np
import torch

import stripe_newton.sim as sim_utils
from stripe_newton.viewers import ViewerCfg, VisualizationMarkers, VisualizationMarkersCfg
from tests.helpers.cart_env import CartCfg, CartEnv, zeros

GOAL = VisualizationMarkersCfg(
    prim_path="/Visuals/goal",
    markers={
        "ball": sim_utils.SphereCfg(
            radius=0.5, visual_material=sim_utils.PreviewSurfaceCfg(diffuse_color=(0.0, 1.0, 0.0))
        )
    },
)


class MarkedEnv(CartEnv):
    """Shows a green ball beside the first cart, where ``height`` says."""

    height = 1.0
    moves = 0

    def _set_debug_vis_impl(self, debug_vis):
        if not hasattr(self, "ball"):
            self.ball = VisualizationMarkers(GOAL, self.sim)
        self.ball.set_visibility(debug_vis)

    def _debug_vis_callback(self, event):
        self.moves += 1
        self.ball.visualize(self.scene.env_origins + torch.tensor([0.0, 0.0, self.height]))


def green(env) -> float:
    """Mean row of the green pixels; NaN if there is none."""
    picture = env.render().astype(int)
    rows = np.nonzero(picture[..., 1] > picture[..., [0, 2]].max(axis=-1) + 60)[0]
    return float(rows.mean()) if len(rows) else float("nan")


def test_markers_move_before_each_picture_and_not_in_a_step():
    cfg = CartCfg()
    cfg.viewer = ViewerCfg(eye=(0.0, -8.0, 1.0), lookat=(0.0, 0.0, 1.0), resolution=(64, 48))
    env = MarkedEnv(cfg, render_mode="rgb_array")
    env.reset(seed=0)
    assert np.isnan(green(env))
    assert env.set_debug_vis(True)
    env.step(zeros(env))
    assert env.moves == 0
    assert abs(green(env) - 23.5) < 3.0
    env.height = 2.0
    assert green(env) < 18.0
    assert env.moves == 2
    assert env.set_debug_vis(False)
    assert np.isnan(green(env))
    assert env.moves == 2
    env.close()
