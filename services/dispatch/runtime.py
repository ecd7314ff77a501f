"""One attempt inside a worker process: the context it is given, its heartbeat, and what is said of its end."""

from __future__ import annotations

import json
import math
import os
import socket
import threading
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import safetensors.numpy

import services
import workers
from services.artifacts.port import ArtifactStore
from services.dispatch.port import (
    Assignment,
    Beat,
    Began,
    Crashed,
    Ended,
    Hindered,
    Message,
    Reported,
    Stopped,
    decode,
    encode,
)
from services.errors import ArtifactDamaged, StorageUnavailable
from services.store.port import NewArtifact
from workers.contracts import BadJob, Checkpoint, Context, Cost, Interrupted, Job
from workers.run import run

BEAT_SECONDS = 2.0
"""A worker says that it lives this often, whatever its training does."""

LOG_LINES = 2000
"""A trial's log keeps its newest lines."""

KEPT_REPORTS = 500
"""So many newest reports travel with a checkpoint. A worker that outlives its coordinator is ended within seconds."""

FIRST_PAUSE, LONGEST_PAUSE = 0.5, 10.0
"""Seconds between tries to reach storage that is full or away; doubling."""

Send = Callable[[Message], None]
Kept = TypeVar("Kept")


def encode_checkpoint(checkpoint: Checkpoint, reports: Sequence[Reported] = ()) -> bytes:
    """A checkpoint as safetensors; counters, random states and the newest reports as JSON metadata."""
    metadata = {
        "iteration": str(checkpoint.iteration),
        "state": json.dumps(checkpoint.state, sort_keys=True),
        "reports": json.dumps([encode(report) for report in reports]),
    }
    return safetensors.numpy.save(dict(checkpoint.tensors), metadata)


def decode_checkpoint(data: bytes) -> tuple[Checkpoint, list[Reported]]:
    """The checkpoint and the reports that `encode_checkpoint` wrote."""
    size = int.from_bytes(data[:8], "little")
    metadata = json.loads(data[8 : 8 + size])["__metadata__"]
    checkpoint = Checkpoint(
        iteration=int(metadata["iteration"]),
        tensors=safetensors.numpy.load(data),
        state=json.loads(metadata["state"]),
    )
    messages = [decode(text) for text in json.loads(metadata["reports"])]
    return checkpoint, [message for message in messages if isinstance(message, Reported)]


class WorkerContext:
    """The `workers.contracts.Context` of one attempt, on an artifact store and a way to send messages."""

    def __init__(self, assignment: Assignment, artifacts: ArtifactStore, send: Send) -> None:
        self._assignment = assignment
        self._artifacts = artifacts
        self._send = send
        self._stop = threading.Event()
        self._kept: dict[str, NewArtifact] = {}
        self._log: list[str] = []
        self._reports: deque[Reported] = deque(maxlen=KEPT_REPORTS)

    def request_stop(self) -> None:
        """Make `stop_requested` true, from any thread."""
        self._stop.set()

    def stop_requested(self) -> bool:
        return self._stop.is_set()

    def report(self, iteration: int, metrics: Mapping[str, float], cost: Cost) -> None:
        report = Reported(
            self._assignment.attempt,
            self._assignment.token,
            iteration=iteration,
            # JSON has no NaN, and a curve no place for one: what isn't finite is left out of the iteration.
            metrics={name: float(value) for name, value in metrics.items() if math.isfinite(value)},
            samples=cost.samples,
            seconds=cost.seconds,
        )
        self._reports.append(report)
        self._send(report)

    def save_checkpoint(self, checkpoint: Checkpoint) -> None:
        data = encode_checkpoint(checkpoint, self._reports)
        key, trial = self._assignment.study_key, self._assignment.trial
        self._patiently(lambda: self._artifacts.put_checkpoint(key, trial, checkpoint.iteration, data))

    def load_checkpoint(self) -> Checkpoint | None:
        key, trial = self._assignment.study_key, self._assignment.trial
        newest = self._patiently(lambda: self._artifacts.newest_checkpoint(key, trial))
        if newest is None:
            return None
        checkpoint, reports = decode_checkpoint(newest[1])
        mine = [replace(each, attempt=self._assignment.attempt, token=self._assignment.token) for each in reports]
        self._reports.extend(mine)
        for report in mine:
            # What an earlier attempt said to a coordinator that was no more is said again.
            if report.iteration > self._assignment.iteration:
                self._send(report)
        return checkpoint

    def save_artifact(self, name: str, data: bytes) -> None:
        assignment = self._assignment
        self._kept[name] = self._patiently(
            lambda: self._artifacts.put(assignment.study_key, assignment.trial, name, data)
        )

    def _patiently(self, do: Callable[[], Kept]) -> Kept:
        """Do something with storage, waiting where it is full or away: no training is lost over it.

        Raises:
            Interrupted: the attempt was asked to stop meanwhile; it goes on from the newest checkpoint that was kept.
        """
        attempt, token = self._assignment.attempt, self._assignment.token
        pause, hindered = FIRST_PAUSE, False
        while True:
            try:
                done = do()
            except StorageUnavailable as error:
                hindered = True
                # Each time: it is also what lets a coordinator in the same thread look up.
                self._send(Hindered(attempt, token, str(error)))
                if self._stop.wait(pause):
                    raise Interrupted(str(error)) from error
                pause = min(2 * pause, LONGEST_PAUSE)
            else:
                if hindered:
                    self._send(Hindered(attempt, token))
                return done

    def parent_artifact(self, name: str) -> bytes:
        for artifact in self._assignment.parent_artifacts:
            if artifact.name == name:
                try:
                    return self._patiently(partial(self._artifacts.read, artifact))
                except ArtifactDamaged as error:
                    raise BadJob(f"its {name} can't be used: {error}") from error
        found = ", ".join(artifact.name for artifact in self._assignment.parent_artifacts) or "nothing"
        raise BadJob(f"expected it to have left {name}, found {found}")

    def log(self, message: str) -> None:
        self._log.append(message)
        del self._log[:-LOG_LINES]

    def artifacts(self) -> tuple[NewArtifact, ...]:
        """What the attempt has kept, with its log."""
        if self._log:
            self.save_artifact("log.txt", ("\n".join(self._log) + "\n").encode())
        return tuple(self._kept.values())


def users_traceback(error: BaseException) -> str:
    """The traceback without our own frames in front: people want to see their code."""
    ours = tuple(str(Path(package.__path__[0]).resolve()) + os.sep for package in (services, workers))
    frames = traceback.extract_tb(error.__traceback__)
    first = next((i for i, frame in enumerate(frames) if not frame.filename.startswith(ours)), 0)
    lines = traceback.format_list(frames[first:]) + traceback.format_exception_only(error)
    return "".join(lines).rstrip()


class Attempt:
    """An assignment being run. `run` blocks; `stop` may be called from another thread.

    Args:
        assignment: what to run.
        artifacts: where checkpoints and results are kept.
        send: called with each message, from `run`'s thread and, where it `beats`, from a second one.
        beats: whether to say every `BEAT_SECONDS` that the attempt lives.
    """

    def __init__(self, assignment: Assignment, artifacts: ArtifactStore, send: Send, *, beats: bool = True) -> None:
        self.assignment = assignment
        self._send = send
        self._beats = beats
        self._context = WorkerContext(assignment, artifacts, send)

    def stop(self) -> None:
        """Ask for a stop at the next checkpoint."""
        self._context.request_stop()

    def run(self) -> None:
        """Run to the end, beating meanwhile; exactly one of `Ended`, `Stopped`, `Crashed` is sent last."""
        attempt, token = self.assignment.attempt, self.assignment.token
        self._send(Began(attempt, token, host=socket.gethostname(), pid=os.getpid()))
        over = threading.Event()
        heart = threading.Thread(target=self._beat, args=(over,), name=f"beat-{attempt}", daemon=True)
        if self._beats:
            heart.start()
        try:
            last = self._last_message()
        finally:
            over.set()
            if self._beats:
                heart.join()
        self._send(last)

    def _beat(self, over: threading.Event) -> None:
        while not over.wait(BEAT_SECONDS):
            self._send(Beat(self.assignment.attempt, self.assignment.token))

    def _last_message(self) -> Message:
        attempt, token = self.assignment.attempt, self.assignment.token
        context: Context = self._context
        try:
            outcome = run(Job.from_json(self.assignment.job), context)
            return Ended(attempt, token, outcome=outcome.to_json(), artifacts=self._context.artifacts())
        except Interrupted:
            return Stopped(attempt, token)
        except BadJob as error:
            return Crashed(attempt, token, message=str(error), retry=False)
        except Exception as error:  # noqa: BLE001 - a user's task may raise anything; its text goes to the record
            return Crashed(attempt, token, message=users_traceback(error))
