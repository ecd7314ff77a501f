"""How fast the pages are, in a real headless Chromium, over a study of 10,000 trials.

- `first view, cold`: from navigation to the study's table and chart being drawn; a new browser without a cache;
- `first view, warm`: the same again in the same browser;
- `commit to screen`: from a trial's commit to the changed count on the page, median and 90th percentile;
- `viewers`: CPU (share of a core) and memory of the server while so many sockets listen and ten trials a second
  start and end; the memory of the same server without viewers beside it;
- `replay`: frames drawn a second while a recorded jump plays, and CPU seconds a frame.

The server runs in a process of its own; the writer shares this one. On a machine that does other things at the same
time, the times are too long and the CPU figures nearly right: the load average is printed beside them.

    python benchmarks/dashboard.py [--trials 10000] [--viewers 100] [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import platform
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import websockets
from playwright.sync_api import Browser, Page, sync_playwright

from services.artifacts import open_artifacts
from services.states import TrialState
from services.store.open import open_store
from services.store.port import AttemptRow, Driver, NewTrial, Result, Store, TrialRow

TOKEN = "a-token-for-benchmarks"
STUDY = "big"
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # fmt: skip
SERVER = """
import sys, uvicorn
from dashboards.app import create_app
from services.artifacts import open_artifacts
from services.store.open import open_store
folder, port, token = sys.argv[1:]
app = create_app(open_store(folder + "/halma.db"), open_artifacts(folder + "/artifacts"), token=token)
uvicorn.run(
    app, host="127.0.0.1", port=int(port), log_level="warning", ws="websockets-sansio", ws_per_message_deflate=False
)
"""
TICKS = os.sysconf("SC_CLK_TCK")


class Writer:
    """A driver of a study, with trials whose values and behaviours spread without chance."""

    def __init__(self, store: Store, name: str) -> None:
        self.store = store
        spec = {
            "name": name,
            "task": {"name": "high_jump", "settings": {}},
            "search": {"strategy": "bds", "trials": 10**6, "settings": {}, "cost": None},
            "space": {f"x{i}": {"type": "float", "low": 0.0, "high": 1.0, "log": False} for i in range(4)},
            "behaviour": {"kind": "circle", "names": ["facing"], "distinct": 0.5, "low": [], "high": [], "unit": "rad"},
            "units": {},
            "has_difficulty": False,
            "trains": True,
        }
        with store.transaction() as change:
            self.id = change.create_study(name, spec, seed=1, target_trials=10**6).id
            self.token = change.drive(name, Driver("benchmark", "here", os.getpid()))
        self.count = 0

    def begin(self, count: int) -> list[tuple[TrialRow, AttemptRow]]:
        """Propose and start so many, in one commit."""
        with self.store.transaction() as change:
            made = [
                NewTrial({f"x{i}": (self.count + k) * (i + 1) * 0.618 % 1 for i in range(4)}, seed=self.count + k)
                for k in range(count)
            ]
            rows = change.propose(
                self.id, self.token, strategy="bds", history=0, pending=(), rng_key=(1,), seconds=0.1, trials=made
            )
            self.count += count
            return [(row, change.start(row.id, self.token, worker="w", host="here")) for row in rows]

    def end(self, begun: list[tuple[TrialRow, AttemptRow]], files: dict[str, bytes] | None = None) -> None:
        """Finish them, in one commit."""
        left = [open_files.put(f"{self.id}-x", begun[0][0].number, name, data) for name, data in (files or {}).items()]
        with self.store.transaction() as change:
            for row, attempt in begun:
                value = row.number * 0.381966 % 1
                facing = (row.number * 2.4 % 6.283) - 3.1415
                result = Result(TrialState.COMPLETE, value, (facing,), samples=7000, seconds=30.0, artifacts=left)
                change.finish(attempt.id, attempt.token, result)


open_files = open_artifacts(Path(tempfile.gettempdir()))


@contextlib.contextmanager
def server(folder: Path) -> Iterator[tuple[str, int]]:
    """A server in a process of its own; its address and process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen([sys.executable, "-c", SERVER, str(folder), str(port), TOKEN])
    url = f"http://127.0.0.1:{port}"
    try:
        for _ in range(600):
            with contextlib.suppress(httpx.HTTPError):
                if httpx.get(f"{url}/healthz").status_code == 200:
                    break
            time.sleep(0.1)
        yield url, process.pid
    finally:
        process.terminate()
        process.wait(20)


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory(pid: int) -> float:
    """Resident memory of a process, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def new_page(browser: Browser, url: str) -> Page:
    """A page of a new context (so an empty cache) that is logged in."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(300_000)
    page = context.new_page()
    page.goto(f"{url}/login")
    page.fill("#token", TOKEN)
    page.click("button[type=submit]")
    page.wait_for_selector("#studies tbody tr")
    return page


def first_view(page: Page, url: str) -> float:
    """Seconds from navigation until table and chart are drawn."""
    start = time.perf_counter()
    page.goto(f"{url}/studies/{STUDY}", wait_until="commit")
    page.wait_for_selector("#table tbody tr[data-number]")
    page.wait_for_selector("#value-chart[data-drawn]")
    return time.perf_counter() - start


def commit_to_screen(page: Page, writer: Writer, repeats: int) -> list[float]:
    """Seconds from commits to the changed count on the page."""
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
    return delays


async def viewers(url: str, pid: int, writer: Writer, count: int, seconds: float) -> tuple[float, int]:
    """CPU share of the server while `count` sockets listen, and the frames they got."""
    address = url.replace("http", "ws") + f"/api/v1/events?study={STUDY}&after={writer.store.last_event()}"
    headers = {"authorization": f"Bearer {TOKEN}"}
    got = 0

    async def view() -> None:
        nonlocal got
        async with websockets.connect(address, additional_headers=headers, compression=None) as opened:
            async for _ in opened:
                got += 1

    tasks = [asyncio.create_task(view()) for _ in range(count)]
    await asyncio.sleep(3)
    got, before, start = 0, cpu_seconds(pid), time.perf_counter()
    while time.perf_counter() - start < seconds:
        writer.end(writer.begin(1))
        await asyncio.sleep(0.1)
    share = (cpu_seconds(pid) - before) / (time.perf_counter() - start)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return share, got


def replay(page: Page, url: str, number: int) -> tuple[float, float]:
    """Frames drawn a second while playing, and the seconds until the replay was ready."""
    start = time.perf_counter()
    page.goto(f"{url}/studies/{STUDY}/trials/{number}", wait_until="commit")
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


def recorded() -> bytes:
    """A second of motion, untrained."""
    from workers.physics.world import World  # noqa: PLC0415  (physics, for this figure only)
    from workers.replay import Recorder  # noqa: PLC0415

    world = World()
    world.athlete.place([-0.8, 1.35, 0.0], [0.0, 0.0, 0.0, 1.0])
    world.athlete.push([2.6, 1.6, 0.0], [0.0, 1.0, -1.0])
    recorder = Recorder("right_ankle", {"name": "high_jump"})
    recorder.start(world)
    for _ in range(120):
        recorder.add(world, world.advance())
    world.close()
    return recorder.replay().to_bytes()


def measure(folder: Path, trials: int, count: int) -> None:
    """Make the record, then take all figures."""
    global open_files  # noqa: PLW0603  (one folder for this run)
    open_files = open_artifacts(folder / "artifacts")
    store = open_store(folder / "halma.db")
    writer = Writer(store, STUDY)
    with_motion = writer.begin(1)
    writer.end(with_motion, {"replay.bin": recorded()})
    while writer.count < trials:
        writer.end(writer.begin(min(500, trials - writer.count)))
    with server(folder) as (url, pid), sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        cold = []
        for _ in range(3):
            browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            page = new_page(browser, url)
            cold.append(first_view(page, url))
            warm = [first_view(page, url) for _ in range(3)]
            if len(cold) < 3:
                browser.close()
        print(f"first view, cold      {statistics.median(cold):8.2f} s   (of {len(cold)})")
        print(f"first view, warm      {statistics.median(warm):8.2f} s   (of {len(warm)})")
        delays = sorted(commit_to_screen(page, writer, 20))
        print(f"commit to screen      {1000 * statistics.median(delays):8.0f} ms  (90 %: {1000 * delays[17]:.0f} ms)")
        frames, ready = replay(page, url, with_motion[0][0].number)
        print(f"replay                {frames:8.1f} frames/s   (ready after {ready:.2f} s)")
        browser.close()
    # Playwright's event loop is this thread's own as long as it runs, so the viewers come after it, at a fresh server.
    with server(folder) as (url, pid):
        quiet = memory(pid)
        share, got = asyncio.run(viewers(url, pid, writer, count, 10.0))
        print(f"{count:3d} viewers: CPU      {100 * share:8.1f} % of a core   ({got} frames)")
        print(f"{count:3d} viewers: memory   {memory(pid):8.0f} MB   (without: {quiet:.0f} MB)")
    store.close()


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=10_000)
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--folder", type=Path, default=None)
    given = parser.parse_args()
    print(f"{given.trials} trials, {platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory(prefix="halma-dashboard-", dir=given.folder) as folder:
        measure(Path(folder), given.trials, given.viewers)


if __name__ == "__main__":
    main()
