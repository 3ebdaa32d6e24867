# SPDX-License-Identifier: Apache-2.0
"""Token page: the live viewer in a real browser through the server that asks for a token."""

from __future__ import annotations

import urllib.error
import urllib.request

import pytest

from stripe_newton.viewers import LiveViewer
from tests.helpers.viewed_boxes import BoxEnv
from tools.pictures.headless_browser import is_available, open_page

pytest.importorskip("viser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not is_available(), reason="needs playwright and chromium"),
]


def test_beyond_this_machine_the_page_opens_with_its_token():
    """127.0.0.2 is an address of this machine, too, but not the one that needs no token."""
    with LiveViewer(BoxEnv(), host="127.0.0.2", port=18640, title="boxes") as viewer:
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(viewer.url.partition("?")[0], timeout=10)
        with open_page(viewer.url, viewer._serve_page, (700, 500)) as page:
            assert "token" not in page.page.url
            page.click(page.button("Pause"))
            page.wait_for(lambda: viewer.time.is_paused, "pause")
