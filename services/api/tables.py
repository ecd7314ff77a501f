"""All trials of a study at once: as columns for tables and charts, and as CSV.

A study may have 50,000 trials and a hundred viewers. What has ended doesn't change, so it is kept per study, and a
request reads only what ended since and what is open or cancelled.
"""

from __future__ import annotations

import csv
import io
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import datetime

from services.api.models import TrialTable
from services.states import TrialState
from services.store.port import Store, StudyRow, TrialRow

UNPLACED = (TrialState.QUEUED, TrialState.RUNNING, TrialState.CANCELLED)
"""States without a place in the history: they are read afresh each time."""
REMEMBERED = 8
"""Studies whose finished trials are kept; a trial takes about 3 kB."""


class FinishedTrials:
    """The finished trials of the studies last asked for. Safe to use from several threads.

    Args:
        store: the trial database.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, int], list[TrialRow]] = OrderedDict()

    def all_trials(self, study: StudyRow) -> list[TrialRow]:
        """Every trial of a study, by number."""
        # A trial that ends between the two reads would be in neither the other way round.
        unplaced = self._store.trials(study.id, states=UNPLACED)
        known = {row.number: row for row in unplaced}
        known.update({row.number: row for row in self.history(study)})
        return [known[number] for number in sorted(known)]

    def history(self, study: StudyRow) -> list[TrialRow]:
        """The finished trials of a study, in order of position."""
        key = (self._store.history_id(), study.id)
        with self._lock:
            finished = self._kept.setdefault(key, [])
            self._kept.move_to_end(key)
            finished.extend(self._store.history(study.id, start=len(finished)))
            while len(self._kept) > REMEMBERED:
                self._kept.popitem(last=False)
            return list(finished)


def _epoch(at: datetime | None) -> float | None:
    return None if at is None else at.timestamp()


def parameter_names(trials: Sequence[TrialRow]) -> list[str]:
    """Names of all parameters, in the order in which they first appear."""
    return list(OrderedDict.fromkeys(name for trial in trials for name in trial.params))


def table(trials: Sequence[TrialRow], *, cursor: int, history: str) -> TrialTable:
    """Trials as columns."""
    mode = [trial.info.get("mode") for trial in trials]
    return TrialTable.model_construct(
        cursor=cursor,
        history=history,
        count=len(trials),
        numbers=[trial.number for trial in trials],
        states=[trial.state.value for trial in trials],
        stages=[trial.stage for trial in trials],
        positions=[trial.position for trial in trials],
        z=[trial.z for trial in trials],
        values=[trial.value for trial in trials],
        samples=[trial.samples for trial in trials],
        seconds=[round(trial.seconds, 3) for trial in trials],
        iterations=[trial.iteration for trial in trials],
        attempts=[trial.attempts for trial in trials],
        warm_starts=[trial.warm_start for trial in trials],
        features=[None if trial.features is None else list(trial.features) for trial in trials],
        started=[_epoch(trial.started_at) for trial in trials],
        finished=[_epoch(trial.finished_at) for trial in trials],
        params={name: [trial.params.get(name) for trial in trials] for name in parameter_names(trials)},
        modes=[value if isinstance(value, str) else None for value in mode],
    )


def csv_lines(trials: Sequence[TrialRow]) -> Iterator[str]:
    """Trials as CSV with a header, one line each. Numbers keep every bit; a list is written as JSON."""
    names = parameter_names(trials)
    header = [
        "number", "stage", "state", "z", "value", "features", "samples", "seconds", "attempts", "warm_start", "seed",
        "started_at", "finished_at", "message", *(f"params.{name}" for name in names),
    ]  # fmt: skip
    return _lines(header, ([
        trial.number, trial.stage, trial.state.value, trial.z, trial.value,
        "" if trial.features is None else json.dumps(list(trial.features)),
        trial.samples, trial.seconds, trial.attempts, trial.warm_start, trial.seed,
        trial.started_at.isoformat() if trial.started_at else "",
        trial.finished_at.isoformat() if trial.finished_at else "",
        unspreadsheet(trial.message), *(unspreadsheet(trial.params.get(name)) for name in names),
    ] for trial in trials))  # fmt: skip


def csv_columns(
    trials: Sequence[TrialRow], columns: Sequence[tuple[str, Callable[[TrialRow], object]]]
) -> Iterator[str]:
    """Some columns of trials as CSV, each by its name and by what reads it. What is no plain value is JSON."""

    def cell(value: object) -> object:
        return json.dumps(value) if isinstance(value, dict | list | tuple) else unspreadsheet(value)

    return _lines([name for name, _ in columns], ([cell(read(trial)) for _, read in columns] for trial in trials))


def _lines(header: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Rows as CSV, in pieces of some 64 kB."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([unspreadsheet(name) for name in header])
    for row in rows:
        writer.writerow(row)
        if buffer.tell() > 65536:
            yield buffer.getvalue()
            buffer.seek(0)
            buffer.truncate()
    yield buffer.getvalue()


def unspreadsheet(value: object) -> object:
    """Text that a spreadsheet would take for a formula, quoted; everything else as it is."""
    if isinstance(value, str) and value[:1] in {"=", "+", "-", "@", "\t", "\r"}:
        return "'" + value
    return value
