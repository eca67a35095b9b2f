"""A headless browser that pages are opened in, and what it heard meanwhile."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@contextmanager
def started():
    """The browser; skips where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright, of the test extra, is not installed")
    path = next((found for name in _NAMES if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip(f"no browser is installed: none of {', '.join(_NAMES)}")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=path, args=list(_FLAGS), timeout=180_000)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser, path: Path, **options):
    """A page from disk, without a network. It may neither complain nor ask for anything but itself."""
    context = browser.new_context(offline=True, viewport={"width": 1200, "height": 800}, **options)
    context.set_default_timeout(40_000)
    reported: list[str] = []
    asked: list[str] = []
    page = context.new_page()
    page.on("console", lambda one: reported.append(f"{one.type}: {one.text}"))
    page.on("pageerror", lambda one: reported.append(f"error: {one}"))
    page.on("request", lambda one: asked.append(one.url))
    page.goto(path.resolve().as_uri())
    try:
        yield page
    finally:
        context.close()
    assert reported == []
    assert asked == [path.resolve().as_uri()]
