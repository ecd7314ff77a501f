"""Progress of a running study, read from the trial database while somebody else drives."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from search.record import SEARCH
from services.budget import has_stages, most_trials
from services.cli.events import metric_words
from services.cli.session import console, say
from services.cli.words import count, duration, first_line, number, several
from services.errors import HalmaError
from services.report import behaviour_of, distinct_trials
from services.states import StudyState, TrialState
from services.store.port import Store, StudyRow, TrialRow

TERMINAL_SECONDS = 0.5
"""How often the picture in a terminal is brought up to date."""

PIPE_SECONDS = 5.0
"""How often a line is printed where nobody can redraw one."""

RATE_SECONDS = 30.0
"""The samples a second are those of the last so many seconds."""

BAR = 30


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A study at one moment.

    Args:
        row: the study.
        done: finished trials.
        running: running trials, by number, with the newest metrics of each.
        distinct: distinct strategies so far; None where behaviour plays no part.
        rate: samples a second; None before it is known.
        left: seconds to go; None before it is known.
    """

    row: StudyRow
    done: int
    running: tuple[tuple[TrialRow, Mapping[str, Any]], ...]
    distinct: int | None
    rate: float | None
    left: float | None


@dataclass
class Observer:
    """Reads snapshots of one study; remembers what a rate needs.

    Args:
        store: the trial database.
        name: the study.
    """

    store: Store
    name: str
    _seen: deque[tuple[float, int]] = field(default_factory=deque)
    _metrics: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    _history: list[TrialRow] = field(default_factory=list)
    _distinct: int | None = None
    _cursor: int | None = None

    def look(self, now: float) -> Snapshot:
        """The study at `now`, monotonic seconds."""
        row = self.store.study(self.name)
        fresh = self.store.history(row.id, start=len(self._history))
        if fresh or self._cursor is None:
            self._history += fresh
            self._distinct = len(distinct_trials(row, self._history)) if behaviour_of(row) else None
        self._follow(row)
        running = self.store.trials(row.id, states={TrialState.RUNNING})
        rate = self._rate(now, row.samples)
        return Snapshot(
            row=row,
            done=len(self._history),
            running=tuple((trial, self._metrics.get(trial.number, {})) for trial in running),
            distinct=self._distinct,
            rate=rate,
            left=self._left(row, running, rate),
        )

    def _follow(self, row: StudyRow) -> None:
        """Take the newest metrics of each trial from the events."""
        if self._cursor is None:
            self._cursor = self.store.last_event()
        while batch := self.store.events(after=self._cursor, study_id=row.id):
            self._cursor = batch[-1].id
            self._metrics.update(
                {
                    event.trial: event.payload.get("metrics", {})
                    for event in batch
                    if event.kind == "progress" and event.trial is not None
                }
            )

    def _rate(self, now: float, samples: int) -> float | None:
        self._seen.append((now, samples))
        while now - self._seen[0][0] > RATE_SECONDS and len(self._seen) > 2:
            self._seen.popleft()
        then, before = self._seen[0]
        span = now - then
        return (samples - before) / span if span >= 1.0 and samples > before else None

    def _left(self, row: StudyRow, running: list[TrialRow], rate: float | None) -> float | None:
        """From the mean of the finished trials' times; under a cost budget from the rate."""
        most = most_trials(row)
        if most is None:
            if row.target_cost is None or not rate:
                return None
            return max(0.0, row.target_cost - row.samples) / rate
        if not self._history:
            return None
        mean = sum(trial.seconds for trial in self._history) / len(self._history)
        remaining = max(0, most - len(self._history))
        begun = sum(min(trial.seconds, mean) for trial in running)
        return max(0.0, remaining * mean - begun) / max(1, len(running))


def progress_line(snapshot: Snapshot) -> str:
    """One line: trials, best, distinct strategies, speed, time left."""
    return ", ".join([_done(snapshot), *_found(snapshot), *_left(snapshot), *_waits(snapshot)])


def _done(snapshot: Snapshot) -> str:
    target = most_trials(snapshot.row)
    most = "at most " if has_stages(snapshot.row) else ""
    return f"{count(snapshot.done)}{'' if target is None else f' of {most}{count(target)}'} trials"


def _found(snapshot: Snapshot) -> list[str]:
    row = snapshot.row
    parts = [] if row.best_value is None else [f"best {number(row.best_value)}"]
    if snapshot.distinct is not None:
        parts.append(several(snapshot.distinct, "distinct strategy"))
    return [*parts, f"{count(row.samples)} samples" + (f" ({count(snapshot.rate)}/s)" if snapshot.rate else "")]


def _left(snapshot: Snapshot) -> list[str]:
    return [f"about {duration(snapshot.left)} left"] if snapshot.left else []


def _waits(snapshot: Snapshot) -> list[str]:
    """Why a study that is driven waits: a full disk, a pool without a host."""
    reason = snapshot.row.reason
    return [first_line(reason, 200)] if reason and snapshot.row.state is StudyState.RUNNING else []


def running_line(trial: TrialRow, metrics: Mapping[str, Any]) -> str:
    """One line for a running trial."""
    if not trial.iteration:
        return f"trial {trial.number}: starting"
    figures = metric_words(metrics) if metrics else ""
    stage = "" if trial.stage == SEARCH else f" ({trial.stage})"
    words = f"trial {trial.number}{stage}: iteration {trial.iteration}, {count(trial.samples)} samples"
    return f"{words}, {figures}" if figures else words


def picture(snapshot: Snapshot) -> RenderableType:
    """What a terminal shows: a bar, the line, and the running trials."""
    target = most_trials(snapshot.row)
    bar = Text()
    if target:
        filled = round(BAR * min(1.0, snapshot.done / target))
        bar = Text("━" * filled, style="green") + Text("━" * (BAR - filled), style="dim") + Text("  ")
    # Two lines, because terminals of eighty columns are still the usual ones.
    lines = [bar + Text(", ".join([_done(snapshot), *_left(snapshot)])), Text(", ".join(_found(snapshot)))]
    lines += [Text(reason, style="yellow") for reason in _waits(snapshot)]
    lines += [Text(f"  {running_line(trial, metrics)}", style="dim") for trial, metrics in snapshot.running]
    return Group(*lines)


@contextmanager
def shown_progress(store: Store, name: str) -> Iterator[None]:
    """Show progress while the block runs: redrawn in a terminal, a plain line now and then anywhere else."""
    over = threading.Event()
    observer = Observer(store, name)
    show = _redraw if console().is_terminal else _print_lines
    thread = threading.Thread(target=show, args=(observer, over), name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(timeout=5.0)


def _snapshots(observer: Observer, over: threading.Event, every: float) -> Iterator[Snapshot]:
    """A snapshot every so many seconds. A database that is away for a moment spoils no display."""
    while not over.wait(every):
        try:
            snapshot = observer.look(time.monotonic())
        except HalmaError:
            continue
        yield snapshot


def _redraw(observer: Observer, over: threading.Event) -> None:
    with Live(console=console(), auto_refresh=False, transient=True) as live:
        for snapshot in _snapshots(observer, over, TERMINAL_SECONDS):
            live.update(picture(snapshot), refresh=True)


def _print_lines(observer: Observer, over: threading.Event) -> None:
    said = ""
    for snapshot in _snapshots(observer, over, PIPE_SECONDS):
        running = "".join(f"; {running_line(trial, metrics)}" for trial, metrics in snapshot.running)
        line = f"{progress_line(snapshot)}{running}"
        if line != said:
            say(line)
            said = line
