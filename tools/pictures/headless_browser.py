# SPDX-License-Identifier: Apache-2.0
"""Headless browser: pages of the live view in a real Chromium without a display, drawn by the CPU.

Needs the extra ``stripe-newton[browser]`` and a Chromium of the system; ``CHROMIUM`` names another one.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

__all__ = ["LivePage", "is_available", "open_page"]

_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)  # fmt: skip
_PATIENCE_S = 60.0
"""Longest wait for something to appear: a CPU draws few pictures a second."""


def is_available() -> bool:
    """Whether playwright and a Chromium are there."""
    return importlib.util.find_spec("playwright") is not None and _chromium() is not None


def _chromium() -> str | None:
    return os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


class LivePage:
    """A page that shows a live view.

    Args:
        page: Playwright's page.
        serve: Lets the program behind the page go on for a moment; it is called while something is waited for.
    """

    def __init__(self, page: Page, serve: Callable[[], None]):
        self.page, self._serve = page, serve

    def wait(self, seconds: float) -> None:
        """Let the page and the program behind it go on."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._serve()
            self.page.wait_for_timeout(20)

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until something is so.

        Raises:
            TimeoutError: it is not so within a minute.
        """
        end = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: not within {_PATIENCE_S:g} s")
            self.wait(0.05)

    def button(self, name: str) -> Locator:
        """A button by its text."""
        return self.page.get_by_role("button", name=name, exact=True)

    def tab(self, name: str) -> Locator:
        """A tab by its text."""
        return self.page.get_by_role("tab", name=name, exact=True)

    def click(self, place: Locator) -> None:
        """Click with the mouse. Playwright's own click waits for calm, which a page that draws on a CPU never has."""
        self.wait_for(lambda: place.first.is_visible(), f"to be seen: {place}")
        place.first.scroll_into_view_if_needed(timeout=1000.0 * _PATIENCE_S)
        box = place.first.bounding_box()
        assert box is not None  # it is visible
        self.page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a dropdown by its label."""
        self.click(self.page.get_by_label(label, exact=True))
        self.click(self.page.get_by_role("option", name=option, exact=True))

    def type_number(self, label: str, number: float) -> None:
        """Type a number into the field beside a slider."""
        row = self.page.get_by_text(label, exact=True).locator("xpath=ancestor::*[.//input][1]")
        field = row.locator("input").last
        self.click(field)
        self.page.keyboard.press("Control+A")
        self.page.keyboard.type(f"{number:g}")
        self.page.keyboard.press("Enter")

    def drag(self, start: tuple[float, float], end: tuple[float, float], key: str = "Control") -> None:
        """Press the left button at a point, move to another, and hold it there; :meth:`release` lets go."""
        mouse = self.page.mouse
        self.page.keyboard.down(key)
        for shift in (-4.0, 0.0):  # the page looks at what is below the pointer when it moves
            mouse.move(start[0] + shift, start[1])
            self.wait(1.0)
        mouse.down()
        self.wait(0.3)
        for share in (0.1, 0.3, 0.6, 1.0):
            mouse.move(*(a + share * (b - a) for a, b in zip(start, end, strict=True)))
            self.wait(0.3)

    def release(self, key: str = "Control") -> None:
        """Let go of what is dragged."""
        self.page.mouse.up()
        self.page.keyboard.up(key)

    def dismiss_notices(self) -> None:
        """Close viser's notice that the page is drawn by a CPU."""
        for button in self.page.locator(".mantine-Notification-closeButton").all():
            button.dispatch_event("click")
        self.wait(0.5)

    def save(self, path: Path, quality: int = 80) -> None:
        """Write a screenshot, ``.jpg`` or ``.png``."""
        path.parent.mkdir(parents=True, exist_ok=True)
        kind = {"type": "jpeg", "quality": quality} if path.suffix == ".jpg" else {"type": "png"}
        self.page.screenshot(path=path, timeout=1000.0 * _PATIENCE_S, **kind)


@contextlib.contextmanager
def open_page(url: str, serve: Callable[[], None], size: tuple[int, int] = (1280, 800)) -> Iterator[LivePage]:
    """Open a page in a browser of its own, and wait until it is connected.

    Args:
        url: The page.
        serve: Lets the program behind the page go on for a moment.
        size: Width and height of the window [px].
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_chromium(), args=list(_FLAGS), headless=True)
        try:
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            page.set_default_timeout(1000.0 * _PATIENCE_S)
            live = LivePage(page, serve)
            page.goto(url)
            live.wait_for(lambda: page.get_by_role("tab").count() > 0, "the page's tabs")
            live.wait(2.0)
            live.dismiss_notices()
            yield live
        finally:
            browser.close()
