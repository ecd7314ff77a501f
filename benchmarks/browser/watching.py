"""What is measured in a real headless Chromium."""

from __future__ import annotations

import contextlib
import shutil
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Page, Playwright, Request

from benchmarks.browser.record import Writer
from benchmarks.browser.servers import TOKEN, Server

FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
PATIENCE_MS = 300_000
SCROLL = """async ([seconds, speed]) => {
  const at = document.getElementById("table");
  const frames = [];
  let long = 0;
  const watch = new PerformanceObserver((list) => { long += list.getEntries().length; });
  watch.observe({ entryTypes: ["longtask"] });
  const start = performance.now();
  let last = start;
  while (last - start < 1000 * seconds) {
    const now = await new Promise((done) => requestAnimationFrame(done));
    frames.push(now - last);
    at.scrollTop = (at.scrollTop + (speed * (now - last)) / 1000) % (at.scrollHeight - at.clientHeight);
    last = now;
  }
  watch.disconnect();
  frames.shift();
  frames.sort((a, b) => a - b);
  return [frames.length / seconds, frames[Math.floor(0.99 * frames.length)], long];
}"""


def launch(playwright: Playwright) -> Browser:
    """A browser without a cache."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    return playwright.chromium.launch(executable_path=chromium, args=FLAGS)


def page_of(browser: Browser, server: Server, *, login: bool = True) -> Page:
    """A page of a new context (so an empty cache), logged in where there is a login."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    if login:
        page.goto(f"{server.url}/login")
        page.fill("#token", TOKEN)
        page.click("button[type=submit]")
        page.wait_for_selector("#studies tbody tr")
    return page


def first_view(page: Page, server: Server, study: str) -> float:
    """Seconds from navigation until table and chart of a study are drawn."""
    start = time.perf_counter()
    page.goto(f"{server.url}/studies/{study}", wait_until="commit")
    page.wait_for_selector("#table tbody tr[data-number]")
    page.wait_for_selector("#value-chart[data-drawn]")
    return time.perf_counter() - start


def optuna_points(page: Page) -> int:
    """How many trials optuna-dashboard's history shows."""
    return int(
        page.evaluate(
            """() => Math.max(0, ...(document.getElementById("plot-history")?.data ?? [])
              .filter((trace) => trace.name?.startsWith("Objective")).map((trace) => trace.x.length))"""
        )
    )


def optuna_first_view(page: Page, server: Server, trials: int) -> float:
    """The same of optuna-dashboard: until its history plot is drawn with all trials. Its table is another page."""
    start = time.perf_counter()
    page.goto(f"{server.url}/dashboard/studies/1", wait_until="commit")
    while optuna_points(page) < trials:
        time.sleep(0.01)
    return time.perf_counter() - start


@dataclass
class FirstViews:
    """Seconds until a study was seen.

    Args:
        cold: by browsers without a cache.
        warm: by browsers that had seen it.
    """

    cold: list[float]
    warm: list[float]

    def words(self) -> str:
        """Medians, with the range."""
        told = [f"{statistics.median(some):5.2f} [{min(some):.2f}, {max(some):.2f}]" for some in (self.cold, self.warm)]
        return f"cold {told[0]} s, warm {told[1]} s"


def first_views(playwright: Playwright, opened: Callable[[Browser], Page], see: Callable[[Page], float]) -> FirstViews:
    """Three browsers, each cold once and warm three times."""
    found = FirstViews([], [])
    for _ in range(3):
        browser = launch(playwright)
        page = opened(browser)
        found.cold.append(see(page))
        found.warm += [see(page) for _ in range(3)]
        browser.close()
    return found


def commit_to_screen(page: Page, writer: Writer, repeats: int) -> list[float]:
    """Seconds from commits to the changed count on the page, sorted."""
    page.wait_for_selector("#link[data-state=live]")
    page.evaluate(
        """() => {
          window.seen = [];
          const at = document.getElementById("fact-trials");
          new MutationObserver(() => requestAnimationFrame(() => window.seen.push(
            [at.textContent, (performance.timeOrigin + performance.now()) / 1000]))).observe(at, { childList: true });
        }"""
    )
    delays = []
    for _ in range(repeats):
        begun = writer.begin(1)
        time.sleep(0.6)
        page.evaluate("() => { window.seen = []; }")
        writer.end(begun)
        committed = time.time()
        while not (seen := page.evaluate("window.seen")):
            time.sleep(0.02)
        delays.append(seen[0][1] - committed)
        time.sleep(0.3)
    return sorted(delays)


def optuna_to_screen(page: Page, add: Callable[[], None], repeats: int) -> list[float]:
    """Seconds from a trial in Optuna's storage to the point in the history plot, sorted."""
    delays = []
    for _ in range(repeats):
        before = optuna_points(page)
        add()
        committed = time.perf_counter()
        while optuna_points(page) == before:
            time.sleep(0.02)
        delays.append(time.perf_counter() - committed)
    return sorted(delays)


@contextlib.contextmanager
def noted(page: Page) -> Iterator[list[tuple[float, str]]]:
    """What a page asks the service for while the block runs: seconds after its start, and path.

    And not longer: the same page is led elsewhere later, and what it asks for there is none of this.
    """
    start = time.perf_counter()
    asked: list[tuple[float, str]] = []

    def note(request: Request) -> None:
        parts = urlsplit(request.url)
        if parts.scheme.startswith("http"):
            asked.append((time.perf_counter() - start, f"{parts.path}?{parts.query}" if parts.query else parts.path))

    page.on("request", note)
    try:
        yield asked
    finally:
        page.remove_listener("request", note)


def requests_of_opening(page: Page, server: Server, study: str) -> list[str]:
    """What a page asks for when a study is opened by somebody who has its scripts already: the page and its data."""
    with noted(page) as asked:
        first_view(page, server, study)
        page.wait_for_selector("#link[data-state=live]")
        page.wait_for_timeout(2000)
    return [path for _, path in asked if not path.startswith("/static")]


def requests_while_live(page: Page, writer: Writer, seconds: float, rate: float) -> list[tuple[float, str]]:
    """What one open page asks the service for by itself while trials come: seconds after the start, and path."""
    with noted(page) as asked:
        start = time.perf_counter()
        while time.perf_counter() - start < seconds:
            writer.end(writer.begin(1))
            page.wait_for_timeout(1000 / rate)
    return [(after, path) for after, path in asked if after < seconds]


def scrolling(page: Page, server: Server, study: str) -> tuple[float, float, float, int]:
    """Seconds until the table of a study is there; then frames a second, the 99th percentile of a frame's time (ms) and
    the long tasks (over 50 ms) of three seconds of scrolling, 3,000 pixels a second.
    """
    start = time.perf_counter()
    page.goto(f"{server.url}/studies/{study}/trials", wait_until="commit")
    page.wait_for_selector("#table tbody tr[data-number]")
    there = time.perf_counter() - start
    page.wait_for_selector("#link[data-state=live]")
    frames, slow, long = page.evaluate(SCROLL, [3.0, 3000])
    return there, frames, slow, long


def replay(page: Page, server: Server, study: str, number: int) -> tuple[float, float]:
    """Frames drawn a second while playing, and the seconds until the replay was ready."""
    start = time.perf_counter()
    page.goto(f"{server.url}/studies/{study}/trials/{number}", wait_until="commit")
    page.wait_for_selector("halma-replay[data-state=ready]")
    ready = time.perf_counter() - start
    drawn, span = page.evaluate(
        """async () => {
          const replay = document.querySelector("halma-replay");
          replay.speed.value = "0.1";
          replay.play();
          await new Promise((done) => setTimeout(done, 500));
          const [from, start] = [replay.drawn, performance.now()];
          await new Promise((done) => setTimeout(done, 4000));
          return [replay.drawn - from, (performance.now() - start) / 1000];
        }"""
    )
    return drawn / span, ready
