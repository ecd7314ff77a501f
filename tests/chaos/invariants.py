"""What must hold of a study whatever was done to it, checked from the trial database alone, with plain SQL.

Nothing here uses the product's own code: a mistake in how the store reads would otherwise hide in its own check.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sqlite3
from collections import Counter, defaultdict
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import psycopg
from psycopg.rows import dict_row

FINAL = {"complete", "infeasible", "diverged", "failed", "cancelled"}
OBSERVED = FINAL - {"cancelled"}
ENDINGS = {"lost", "failed", "preempted", "finished"}
"""Events that end an attempt."""


class Record:
    """The tables of one study, read at one moment.

    Args:
        database: path of a SQLite file, or a URL of a PostgreSQL database.
        study: name of the study.
    """

    def __init__(self, database, study):
        def rows(sql, *values):
            if "://" in database:
                return list(connection.execute(sql.replace("?", "%s"), values))
            return [dict(row) for row in connection.execute(sql, values)]

        if "://" in database:
            opened = psycopg.connect(database, row_factory=dict_row)
            opened.isolation_level = psycopg.IsolationLevel.REPEATABLE_READ
        else:
            opened = sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=30)
            opened.row_factory = sqlite3.Row
        with closing(opened) as connection:
            if "://" not in database:
                connection.execute("BEGIN")
            found = rows("SELECT * FROM studies WHERE name = ?", study)
            self.study = found[0] if found else None
            if self.study is None:
                return
            of = self.study["id"]
            self.trials = rows("SELECT * FROM trials WHERE study_id = ? ORDER BY number", of)
            within = "WHERE trial_id IN (SELECT id FROM trials WHERE study_id = ?)"
            self.attempts = rows(f"SELECT * FROM attempts {within} ORDER BY trial_id, number", of)
            self.metrics = rows(f"SELECT * FROM metrics {within} ORDER BY trial_id, iteration", of)
            self.artifacts = rows(f"SELECT * FROM artifacts {within} ORDER BY trial_id, name", of)
            self.proposals = rows("SELECT * FROM proposals WHERE study_id = ? ORDER BY id", of)
            self.events = rows("SELECT * FROM events WHERE study_id = ? ORDER BY id", of)
            # Of no study: it is the driver's word that the database was away for a while.
            self.times_away = rows("SELECT count(*) AS n FROM events WHERE kind = ?", "database_back")[0]["n"]
        for event in self.events:
            event["payload"] = json.loads(event["payload"])

    def processes(self):
        """By trial number, the process and host of each attempt in order, None where it was never heard of."""
        if self.study is None:
            return {}
        numbers = {row["id"]: row["number"] for row in self.trials}
        found = defaultdict(list)
        for row in self.attempts:
            heard = row["pid"] is not None
            found[numbers[row["trial_id"]]].append(f"{row['pid']}@{row['host']}" if heard else None)
        return found

    def finished(self):
        """All that is on record of the trials that have ended, by number: it may never change again."""
        left = defaultdict(list)
        for row in self.artifacts:
            left[row["trial_id"]].append((row["name"], row["path"], row["sha256"], row["size"]))
        return {row["number"]: (row, left[row["id"]]) for row in self.trials if row["state"] in FINAL}


@dataclass
class Verdict:
    """What a check found.

    Args:
        lost: finished trials that are gone or have changed.
        duplicated: results, positions, numbers or attempts that exist twice.
        stuck: trials without an end.
        broken: everything else that must hold and doesn't, in words.
        repeated: iterations that were computed more often than once.
        interrupted: attempts that did not reach their end.
    """

    lost: int = 0
    duplicated: int = 0
    stuck: int = 0
    broken: list[str] = field(default_factory=list)
    repeated: int = 0
    interrupted: int = 0

    @property
    def good(self):
        """Whether the promise was kept."""
        return not (self.lost or self.duplicated or self.stuck or self.broken)

    def expect(self, holds, words):
        """Note what doesn't hold."""
        if not holds:
            self.broken.append(words)


def check(record, root, *, seen=(), work=None, samples_each=None):
    """Check a study that has come to its end.

    Args:
        record: its `Record`.
        root: folder of the artifacts.
        seen: `Record.finished()` of earlier moments.
        work: file in which the tasks noted every iteration that began, for counting repeated ones.
        samples_each: cost of an iteration of this task, where it is known.
    """
    verdict = Verdict()
    verdict.expect(record.study["state"] == "complete", f"the study ended {record.study['state']}")
    _check_trials(record, verdict)
    _check_attempts(record, verdict)
    _check_events(record, verdict)
    _check_curves(record, verdict, samples_each)
    _check_artifacts(record, root, verdict)
    now = record.finished()
    for moment in seen:
        for number, then in moment.items():
            if now.get(number) != then:
                verdict.lost += 1
                verdict.broken.append(f"trial {number} was {then}, is {now.get(number)}")
    if work is not None:
        _count_repetitions(record, Path(work), verdict)
    return verdict


def _check_trials(record, verdict):
    numbers = [row["number"] for row in record.trials]
    verdict.duplicated += len(numbers) - len(set(numbers))
    verdict.expect(sorted(numbers) == list(range(len(numbers))), f"trial numbers have holes: {numbers}")
    verdict.expect(record.study["trial_count"] == len(numbers), "the study counts other trials than it has")
    verdict.expect(len(numbers) == record.study["target_trials"], f"{len(numbers)} trials, not as many as asked for")
    positions = sorted(row["position"] for row in record.trials if row["state"] in OBSERVED)
    verdict.duplicated += len(positions) - len(set(positions))
    verdict.expect(positions == list(range(len(positions))), f"the history has holes: {positions}")
    for row in record.trials:
        if row["state"] not in FINAL:
            verdict.stuck += 1
            verdict.broken.append(f"trial {row['number']} is {row['state']} in a study that has ended")
        verdict.expect(row["proposal_id"] is not None, f"nobody proposed trial {row['number']}")
    proposed = [
        number for event in record.events if event["kind"] == "proposed" for number in event["payload"]["trials"]
    ]
    verdict.duplicated += len(proposed) - len(set(proposed))
    verdict.expect(sorted(proposed) == sorted(numbers), "the trials are not those that were proposed")
    verdict.expect(
        sum(row["count"] for row in record.proposals) == len(numbers), "the proposals count other trials than there are"
    )


def _check_attempts(record, verdict):
    of = defaultdict(list)
    for row in record.attempts:
        of[row["trial_id"]].append(row)
    for trial in record.trials:
        rows, name = of[trial["id"]], f"trial {trial['number']}"
        verdict.expect([row["number"] for row in rows] == list(range(1, len(rows) + 1)), f"{name}: attempts have holes")
        verdict.expect(trial["attempts"] == len(rows), f"{name} counts other attempts than it has")
        tokens = [row["token"] for row in rows]
        verdict.expect(all(a < b for a, b in itertools.pairwise(tokens)), f"{name}: tokens fall: {tokens}")
        ended = [row for row in rows if row["state"] == trial["state"] and row["state"] in OBSERVED]
        if trial["state"] == "complete":
            verdict.duplicated += max(0, len(ended) - 1)
            verdict.expect(len(ended) == 1, f"{name}: {len(ended)} attempts are complete")
        for row in rows:
            verdict.expect(row["state"] != "running", f"{name}: attempt {row['number']} still runs")
            verdict.expect(row["ended_at"] is not None, f"{name}: attempt {row['number']} has no end")
        for row in rows[:-1]:
            verdict.expect(row["state"] in {"lost", "failed", "preempted"}, f"{name}: went on after {row['state']}")
        counted = sum(row["state"] in {"lost", "failed"} for row in rows)
        verdict.expect(trial["retries"] <= counted, f"{name}: {trial['retries']} retries, {counted} lost or failed")
        verdict.interrupted += sum(row["state"] in {"lost", "preempted", "failed"} for row in rows)


def _check_events(record, verdict):
    """The journal tells one story: one holder at a time, tokens that rise, nothing by who was fenced off."""
    token, holder, ended = 0, {}, set()
    for event in record.events:
        kind, trial, payload = event["kind"], event["trial"], event["payload"]
        if kind == "driven":
            verdict.expect(payload["token"] == token + 1, f"drive token {payload['token']} came after {token}")
            token = payload["token"]
        if trial is None or "attempt" not in payload:
            continue
        attempt = payload["attempt"]
        verdict.expect(trial not in ended, f"{kind} of trial {trial} after its end (event {event['id']})")
        if kind == "started":
            verdict.expect(holder.get(trial) is None, f"trial {trial} was started while an attempt ran")
            holder[trial] = attempt
        elif attempt is not None:
            verdict.expect(
                holder.get(trial) == attempt,
                f"{kind} by attempt {attempt} of trial {trial}, which {holder.get(trial)} holds (event {event['id']})",
            )
        if kind in ENDINGS:
            holder[trial] = None
        if kind == "finished":
            ended.add(trial)
    verdict.expect(token == record.study["drive_token"], "the study's token is not that of its last driver")
    finishes = Counter(event["trial"] for event in record.events if event["kind"] == "finished")
    verdict.duplicated += sum(count - 1 for count in finishes.values())
    verdict.expect(
        sorted(finishes) == [row["number"] for row in record.trials if row["state"] in FINAL],
        "the events name other finished trials than the table",
    )
    rows = {row["number"]: row for row in record.trials}
    for event in record.events:
        if event["kind"] == "finished" and event["trial"] in rows:
            row, payload = rows[event["trial"]], event["payload"]
            features = None if row["features"] is None else json.loads(row["features"])
            same = (row["state"], row["position"], row["value"], features, row["samples"]) == tuple(
                payload.get(name) for name in ("state", "position", "value", "features", "samples")
            )
            verdict.expect(same or row["state"] == "cancelled", f"trial {event['trial']} is not what its event says")


def _check_curves(record, verdict, samples_each):
    curves = defaultdict(list)
    for row in record.metrics:
        curves[row["trial_id"]].append(row)
    last = {}
    for event in record.events:
        if event["kind"] == "progress":
            last[event["trial"]] = event["payload"]
    for trial in record.trials:
        rows, name = curves[trial["id"]], f"trial {trial['number']}"
        iterations = [row["iteration"] for row in rows]
        verdict.expect(iterations == list(range(1, len(iterations) + 1)), f"{name}: its curve has holes: {iterations}")
        by = [row["attempt"] for row in rows]
        verdict.expect(by == sorted(by), f"{name}: an earlier attempt wrote over a later one: {by}")
        if trial["state"] != "complete":
            continue
        verdict.expect(trial["iteration"] == len(iterations), f"{name}: at {trial['iteration']}, curve {iterations}")
        told = last.get(trial["number"], {}).get("samples")
        verdict.expect(trial["samples"] == told, f"{name}: cost {trial['samples']}, its last report said {told}")
        if samples_each is not None:
            verdict.expect(
                trial["samples"] == samples_each * len(iterations),
                f"{name}: {trial['samples']} samples for {len(iterations)} iterations of {samples_each}",
            )


def _check_artifacts(record, root, verdict):
    left = Counter(row["trial_id"] for row in record.artifacts)
    for trial in record.trials:
        if trial["state"] == "complete":
            verdict.expect(left[trial["id"]] > 0, f"trial {trial['number']} left nothing")
    for row in record.artifacts:
        path = Path(root) / row["path"]
        data = path.read_bytes() if path.exists() else None
        whole = data is not None and (len(data), hashlib.sha256(data).hexdigest()) == (row["size"], row["sha256"])
        verdict.expect(whole, f"artifact {row['path']} is {'altered' if data is not None else 'gone'}")


def _count_repetitions(record, work, verdict):
    lines = work.read_text(encoding="utf-8").splitlines() if work.exists() else []
    begun = Counter()
    for line in lines:
        study, trial, iteration, _ = line.split()
        if study == record.study["name"]:
            begun[int(trial), int(iteration)] += 1
    verdict.repeated = sum(count - 1 for count in begun.values())


def what_counts(record):
    """All of a study that doesn't depend on the time of day: what an undisturbed one must equal bit for bit."""
    policies = {row["trial_id"]: row["sha256"] for row in record.artifacts if row["name"].startswith("policy")}
    names = ("number", "position", "state", "params", "z", "warm_start", "seed", "value", "features", "samples", "info")
    curves = defaultdict(list)
    for row in record.metrics:
        curves[row["trial_id"]].append((row["iteration"], row["metrics"]))
    return [({name: row[name] for name in names}, policies.get(row["id"]), curves[row["id"]]) for row in record.trials]
