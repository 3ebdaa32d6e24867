# SPDX-License-Identifier: Apache-2.0
"""Slow browser: what the live view shows in a page whose processor is throttled."""

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


def test_a_robot_that_is_followed_stays_where_it_is_in_a_slow_browser():
    images = pytest.importorskip("PIL.Image")
    env = BoxEnv(1)
    cfg = ViewerCfg(origin_type="asset_root", eye=(0.0, -4.0, 1.5), lookat=(0.0, 0.0, 0.0), follow_time=0.0)

    def serve():
        viewer._serve_page()
        if viewer.time.takes_step():
            for _ in range(4):  # 2 m/s
                env.step()
            viewer.after_step()

    with (
        LiveViewer(env, cfg=cfg, title="boxes", port=18620) as viewer,
        open_page(viewer.url, serve, (900, 600)) as page,
    ):
        session = page.page.context.new_cdp_session(page.page)
        session.send("Emulation.setCPUThrottlingRate", {"rate": 4})
        page.wait(2.0)
        columns = []
        for _ in range(6):
            page.wait(0.3)
            image = np.asarray(images.open(io.BytesIO(page.page.screenshot())).convert("RGB")).astype(int)
            red = (image[..., 0] > 90) & (image[..., 1:] < 60).all(axis=-1)
            columns.append(np.nonzero(red[:, :500])[1].mean())
        assert env.box_positions[0, 0] > 1.0  # it moves
        # Tens of pixels if the page moves the world before it moves the robots.
        assert np.ptp(columns) < 3.0
