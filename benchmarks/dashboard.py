"""How fast the pages are, in a real headless Chromium, over a study of 10,000 trials, beside optuna-dashboard.

- `first view`: from navigation to the study's table and chart being drawn, by browsers without a cache (cold) and by
  the same ones again (warm); for optuna-dashboard, over the same study exported, until its history plot is drawn;
- `commit to screen`: from a trial's commit to the changed page, median and 90th percentile;
- `viewers`: CPU (share of a core) and memory of the server while so many people have the study's page open and trials
  start and end. A viewer asks for what a page was seen to ask for when it was opened (all of them at the same time,
  before the CPU is measured; the memory after it counts), then listens at a socket and makes the requests that one
  open page was seen to make by itself in a minute. Requests noted later, when the same browser was led to
  tables and replays, are no part of it: until November 2026 they were, nine of ten. With optuna-dashboard a
  viewer is the poll that its page makes every ten seconds;
- `table of 50,000`: seconds until it is there, and frames a second while it scrolls, beside a table of 300;
- `replay`: data frames drawn a second while a recorded jump plays.

The servers run in processes of their own; the writer shares this one. On a machine that does other things at the same
time, the times are too long: the load average is printed beside them, before and after.

    python benchmarks/dashboard.py [--trials 10000] [--viewers 100] [--rate 1] [--rows 50000] [--no-optuna]
"""

from __future__ import annotations

import argparse
import asyncio
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import optuna
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.browser import crowd, servers, watching
from benchmarks.browser.record import Writer, motion, multiply
from services.artifacts.open import open_artifacts
from services.store.open import open_store

STUDY = "big"
SPAN = 60.0
"""Seconds for which a page's own requests are noted: what it asks for most rarely comes every 20 to 40 seconds."""
POLL = 10.0
"""Seconds between two polls of optuna-dashboard's page, as it comes."""


def measure(folder: Path, given: argparse.Namespace) -> None:
    """Make the record, then take all figures."""
    store = open_store(folder / "halma.db")
    artifacts = open_artifacts(folder / "artifacts")
    many, few = (Writer(store, artifacts, name) for name in ("many", "few"))
    for one, count in ((many, given.rows), (few, 300)):
        one.end(one.begin(1))
        multiply(folder / "halma.db", one.id, count)
    writer = Writer(store, artifacts, STUDY)
    moving = writer.begin(1)
    writer.end(moving, {"replay.bin": motion()})
    writer.fill(given.trials)
    if given.optuna:
        began = time.perf_counter()
        export = [str(Path(sys.executable).parent / "halma"), "export", STUDY, "--format", "optuna"]
        export += ["--output", str(folder / "optuna.db"), "--db", str(folder / "halma.db")]
        subprocess.run(export, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "HALMA_HOME": str(folder)})
        print(f"exported to Optuna in {time.perf_counter() - began:.0f} s")
    with servers.halma(folder) as server, sync_playwright() as playwright:
        views = watching.first_views(
            playwright,
            lambda browser: watching.page_of(browser, server),
            lambda page: watching.first_view(page, server, STUDY),
        )
        print(f"first view, halma                 {views.words()}")
        browser = watching.launch(playwright)
        page = watching.page_of(browser, server)
        watching.first_view(page, server, STUDY)
        told("commit to screen, halma", watching.commit_to_screen(page, writer, 20))
        opening = watching.requests_of_opening(page, server, STUDY)
        asked = watching.requests_while_live(page, writer, SPAN, given.rate)
        for name, rows in (("many", given.rows), ("few", 300)):
            there, frames, slow, long = watching.scrolling(page, server, name)
            print(
                f"table of {rows:6,}                   there after {there:.2f} s; scrolling {frames:.0f} frames/s, "
                f"99 % under {slow:.0f} ms, {long} long tasks"
            )
        frames, ready = watching.replay(page, server, STUDY, moving[0][0].number)
        print(f"replay                            {frames:.1f} data frames/s   (ready after {ready:.2f} s)")
        browser.close()
    # Playwright's event loop is this thread's own as long as it runs, so the viewers come after it, at a fresh server.
    with servers.halma(folder) as server:
        quiet = server.memory()
        share, frames_got, requests = asyncio.run(
            crowd.watched(
                server,
                listen=f"/api/v1/events?study={STUDY}&after={store.last_event()}",
                opening=opening,
                asked=asked,
                span=SPAN,
                count=given.viewers,
                write=lambda: writer.end(writer.begin(1)),
                rate=given.rate,
                seconds=given.seconds,
            )
        )
        print(
            f"{given.viewers} viewers, halma                {100 * share:.1f} % of a core, {server.memory():.0f} MB "
            f"(without: {quiet:.0f} MB), {given.rate:g} trials/s, {frames_got} frames, {requests} requests "
            f"({len(asked) / SPAN:.2f} a second and page: {kinds(asked)})"
        )
    store.close()
    if given.optuna:
        beside(folder, writer.count, given)


def beside(folder: Path, trials: int, given: argparse.Namespace) -> None:
    """The same of optuna-dashboard over the study exported."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    database = folder / "optuna.db"
    study = optuna.load_study(study_name=None, storage=f"sqlite:///{database}")
    known = len(study.trials)
    template = study.trials[0]

    count = known

    def add() -> None:
        nonlocal count
        study.add_trial(template)
        count += 1

    with servers.optuna_dashboard(database) as server, sync_playwright() as playwright:
        views = watching.first_views(
            playwright,
            lambda browser: watching.page_of(browser, server, login=False),
            lambda page: watching.optuna_first_view(page, server, known),
        )
        print(f"first view, optuna-dashboard      {views.words()}   ({known} of {trials} trials)")
        browser = watching.launch(playwright)
        page = watching.page_of(browser, server, login=False)
        watching.optuna_first_view(page, server, known)
        told("commit to screen, optuna-dashboard", watching.optuna_to_screen(page, add, 6))
        browser.close()
    with servers.optuna_dashboard(database) as server:
        quiet = server.memory()
        share, requests = asyncio.run(
            crowd.polled(
                server,
                path=lambda: f"/api/studies/1?after={count}",
                every=POLL,
                count=given.viewers,
                write=add,
                rate=given.rate,
                seconds=given.seconds,
            )
        )
        print(
            f"{given.viewers} viewers, optuna-dashboard     {100 * share:.1f} % of a core, {server.memory():.0f} MB "
            f"(without: {quiet:.0f} MB), {given.rate:g} trials/s, {requests} requests"
        )


def kinds(asked: Sequence[tuple[float, str]]) -> str:
    """What a page asked for, by the last part of the path, and how often."""
    count = Counter(path.partition("?")[0].rpartition("/")[2] for _, path in asked)
    return ", ".join(f"{name} {times}" for name, times in count.most_common()) or "none"


def told(what: str, delays: list[float]) -> None:
    """A line of delays."""
    late = delays[min(len(delays) - 1, round(0.9 * len(delays)) - 1)]
    print(f"{what:33s} {1000 * statistics.median(delays):.0f} ms  (90 %: {1000 * late:.0f} ms, {len(delays)} times)")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=10_000)
    parser.add_argument("--viewers", type=int, default=100)
    parser.add_argument("--rate", type=float, default=1.0, help="trials a second while people watch")
    parser.add_argument("--seconds", type=float, default=30.0, help="how long they watch")
    parser.add_argument("--rows", type=int, default=50_000, help="of the table that scrolls")
    parser.add_argument("--no-optuna", dest="optuna", action="store_false", help="leave optuna-dashboard out")
    parser.add_argument("--folder", type=Path, default=None)
    given = parser.parse_args()
    load = [f"{value:.1f}" for value in os.getloadavg()]
    print(f"{given.trials} trials, {platform.machine()}, {os.cpu_count()} cores, load {' '.join(load)}")
    with tempfile.TemporaryDirectory(prefix="halma-dashboard-", dir=given.folder) as folder:
        measure(Path(folder), given)
    print(f"load afterwards {' '.join(f'{value:.1f}' for value in os.getloadavg())}")


if __name__ == "__main__":
    main()
