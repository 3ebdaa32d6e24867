# SPDX-License-Identifier: Apache-2.0
"""Report in a real browser: the pointer shows the numbers of the curves, and nothing is asked of the network."""

from __future__ import annotations

import pytest

from stripe_newton.rl.report.report_data import read_run
from stripe_newton.rl.report.run_report import write_report
from tests.helpers.run_files import REWARD, write_run
from tools.pictures import headless_browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not headless_browser.is_available(), reason="needs playwright and a Chromium"),
]


def test_the_pointer_shows_the_numbers(tmp_path):
    from playwright.sync_api import sync_playwright

    one = write_run(tmp_path / "one", [float(at) for at in range(101)])
    two = write_run(tmp_path / "two", [2.0 * at for at in range(101)])
    file = tmp_path / "report.html"
    write_report([read_run(one), read_run(two)], file)
    with sync_playwright() as playwright:
        program, flags = headless_browser._chromium(), list(headless_browser._FLAGS)
        browser = playwright.chromium.launch(executable_path=program, args=flags, headless=True)
        page, problems, requests = browser.new_page(), [], []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(file.as_uri())
        figure = page.locator(f'figure[data-column="{REWARD}"]')
        assert figure.locator(".now").inner_text() == "100 | 200"
        chart = figure.locator("svg")
        chart.scroll_into_view_if_needed()
        left, right = (float(edge) for edge in chart.get_attribute("data-edges").split())
        box, width = chart.bounding_box(), chart.evaluate("svg => svg.viewBox.baseVal.width")
        # x runs from iteration 1 at the left edge to 101 at the right one.
        page.mouse.move(box["x"] + (left + 0.5 * (right - left)) / width * box["width"], box["y"] + box["height"] / 2)
        assert figure.locator(".now").inner_text() == "at 51: 50 | 100"
        page.mouse.move(0, 0)
        assert figure.locator(".now").inner_text() == "100 | 200"
        assert problems == []
        assert requests == [file.as_uri()]
        browser.close()
