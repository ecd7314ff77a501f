"""The port between the coordinator and whatever runs trials: assignments out, messages back.

Messages travel as JSON text, so that an adapter may carry them between processes and machines without trusting
the other side to hand it code.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

from services.store.port import JSON, NewArtifact


@dataclass(frozen=True, slots=True)
class Assignment:
    """One attempt, as a worker gets it.

    Args:
        attempt: row id of the attempt.
        token: its fencing token; every message about the attempt carries it.
        study_key: folder of the study in the artifact store.
        trial: number of the trial within its study.
        job: `workers.contracts.Job` as JSON.
        pool: the worker pool it runs in.
        cpus: cores it may use.
        parent_artifacts: what the trial left whose policy this one starts from.
        iteration: the last iteration that is on record.
    """

    attempt: int
    token: int
    study_key: str
    trial: int
    job: str
    pool: str = "default"
    cpus: float = 1.0
    parent_artifacts: tuple[NewArtifact, ...] = ()
    iteration: int = 0


@dataclass(frozen=True, slots=True)
class Began:
    """A worker process has taken the attempt up."""

    attempt: int
    token: int
    host: str
    pid: int


@dataclass(frozen=True, slots=True)
class Beat:
    """The attempt lives."""

    attempt: int
    token: int


@dataclass(frozen=True, slots=True)
class Hindered:
    """The attempt can't keep its files now (a full disk, a server away) and waits; without a reason it goes on."""

    attempt: int
    token: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Reported:
    """An iteration is done. `samples` and `seconds` count from the first attempt on."""

    attempt: int
    token: int
    iteration: int
    metrics: dict[str, float]
    samples: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Ended:
    """The job came to its own end. `outcome` is `workers.contracts.Outcome` as JSON; artifacts are safe on storage."""

    attempt: int
    token: int
    outcome: str
    artifacts: tuple[NewArtifact, ...] = ()


@dataclass(frozen=True, slots=True)
class Stopped:
    """The job stopped at a checkpoint because it was asked to."""

    attempt: int
    token: int


@dataclass(frozen=True, slots=True)
class Crashed:
    """The task raised. `retry` says whether another try makes sense; `message` is for the person who wrote it."""

    attempt: int
    token: int
    message: str
    retry: bool = True


@dataclass(frozen=True, slots=True)
class Vanished:
    """The worker process is gone."""

    attempt: int
    token: int
    reason: str


Message = Began | Beat | Hindered | Reported | Ended | Stopped | Crashed | Vanished


def encode_assignment(assignment: Assignment) -> str:
    """The assignment as JSON text."""
    return json.dumps(asdict(assignment))


def decode_assignment(text: str) -> Assignment:
    """The assignment that `encode_assignment` wrote."""
    values: dict[str, JSON] = json.loads(text)
    values["parent_artifacts"] = tuple(NewArtifact(**artifact) for artifact in values["parent_artifacts"])
    return Assignment(**values)


_KINDS: dict[str, type[Any]] = {
    kind.__name__: kind for kind in (Began, Beat, Hindered, Reported, Ended, Stopped, Crashed, Vanished)
}

Deliver = Callable[[Sequence[Message]], None]
"""What an adapter calls with the messages that arrived together; they share one commit."""


def encode(message: Message) -> str:
    """The message as JSON text."""
    return json.dumps({"kind": type(message).__name__, **asdict(message)})


def decode(text: str) -> Message:
    """The message that `encode` wrote. Unknown kinds and fields are refused by name."""
    values: dict[str, JSON] = json.loads(text)
    kind = _KINDS[values.pop("kind")]
    if "artifacts" in values:
        values["artifacts"] = tuple(NewArtifact(**artifact) for artifact in values["artifacts"])
    unknown = set(values) - {field.name for field in fields(kind)}
    if unknown:
        raise ValueError(f"{kind.__name__} has no field {sorted(unknown)}")
    message: Message = kind(**values)
    return message


class Dispatcher(Protocol):
    """Runs assignments on worker pools. Starting never blocks; what happens comes back through `poll`."""

    def pools(self) -> dict[str, int]:
        """Names and sizes (cores) of the pools."""

    def rooms(self, pool: str) -> Mapping[str, float]:
        """Cores of a pool that nothing runs on, by host; hosts without any may be missing."""

    def sizes(self, pool: str) -> Mapping[str, float]:
        """Cores that each host gives to a pool, busy or not; none where no host gives any."""

    def where(self, attempt: int) -> str | None:
        """The host on which an attempt runs; None where it doesn't run (any more)."""

    def open(self, study_key: str, task: str) -> None:
        """Make ready for trials of a study: its task's code as it is now is what all of them run.

        Raises `BadInput` where the code can't be sent to workers.
        """

    def start(self, assignment: Assignment) -> str:
        """Hand an attempt to a worker of its pool; returns the worker's name."""

    def stop(self, attempt: int) -> None:
        """Ask an attempt to checkpoint and stop. Unknown attempts are ignored: it may just have ended."""

    def kill(self, attempt: int) -> None:
        """End an attempt's worker process at once; no message follows. Unknown attempts are ignored."""

    def poll(self, deliver: Deliver, timeout: float) -> None:
        """Wait up to `timeout` seconds for messages and deliver them, together where they arrived together."""

    def drop_checkpoints(self, study_key: str, trial: int) -> None:
        """Remove the checkpoints of a trial that has ended, some time soon; what fails is left to `halma gc`."""

    def close(self) -> None:
        """End all workers."""
