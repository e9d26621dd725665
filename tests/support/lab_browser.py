"""A lab in a process of its own, and a browser that looks at its pages; what the browser complains of fails a test."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from layout import ROOT

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PAGES = ROOT / "nmes" / "lab" / "pages" / "index.html"
AXE = ROOT / "lab" / "node_modules" / "axe-core" / "axe.min.js"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
PASSWORD = "pages"  # of the lab's worlds, over TCP
PATIENCE = 30_000.0  # ms
SOFTWARE = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox"]


@dataclass
class Lab:
    """A lab that runs."""

    folder: Path
    url: str  # with the token
    port: int
    host_port: int  # of its worlds, over TCP

    def at(self, path: str) -> str:
        """Returns the address of a page: `lab.at("worlds/main")`."""
        return f"http://127.0.0.1:{self.port}/#/{path}"


@contextmanager
def served_lab(folder: Path) -> Iterator[Lab]:
    """Runs `nmes lab` on a folder."""
    command = [sys.executable, "-m", "nmes", "lab", "--dir", str(folder), "--port", "0", "--no-open", "--json"]
    environment = {**os.environ, "NMES_PASSWORD": PASSWORD}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        try:
            told = json.loads(process.stdout.readline())
            yield Lab(folder, told["url"], told["port"], told["host_port"])
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


@contextmanager
def running_browser() -> Iterator[Browser]:
    """Runs a browser without a screen; skips the test where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no browser to look with: Playwright is missing")
    chromium = next(filter(None, map(shutil.which, BROWSERS)), None)
    if chromium is None:
        pytest.skip("no browser to look with: Chromium is missing")
    assert PAGES.is_file(), "the pages are not built: make lab"
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=SOFTWARE)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Browser, lab: Lab, path: str, **settings: Any) -> Iterator[Page]:
    """Opens a page of a lab; when it is closed, nothing may have been complained of."""
    context = browser.new_context(**settings)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.goto(lab.url)
    page.goto(lab.at(path))
    page.wait_for_selector("main .page h1")
    yield page
    context.close()
    assert complaints == []


def serious(page: Page) -> list[str]:
    """Returns what axe-core finds on a page that keeps people out."""
    page.evaluate(AXE.read_text())
    found = page.evaluate("axe.run()")["violations"]
    return [
        f"{each['id']}: {node['target']} {node['failureSummary']}"
        for each in found
        if each["impact"] in ("serious", "critical")
        for node in each["nodes"]
    ]
