"""Simulating a stored policy again, and whether that gives the stored replay to the last bit."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from services.artifacts.port import ArtifactStore
from services.errors import BadInput
from services.report import spec_of
from services.states import TrialState
from services.store.port import ArtifactRow, Store, StudyRow, TrialRow
from services.translate import job_of
from workers.contracts import BadJob, Job
from workers.registry import load_task

POLICY = "policy.safetensors"
REPLAY = "replay.bin"


class Recording(Protocol):
    """A replay as a task gives it."""

    @property
    def seconds(self) -> float:
        """Duration."""

    def to_bytes(self) -> bytes:
        """What is stored; equal replays give equal bytes."""


@runtime_checkable
class Simulates(Protocol):
    """A task whose stored policies can be simulated again."""

    def simulate(self, job: Job, policy: bytes) -> Recording:
        """The best episode of a stored policy. Raises `BadJob` where there is none."""


@dataclass(frozen=True, slots=True)
class Again:
    """A policy simulated again.

    Args:
        trial: whose policy it is.
        recording: the new replay.
        sha256: of its bytes.
        stored: SHA-256 of the replay that the trial left, or None where it left none.
    """

    trial: TrialRow
    recording: Recording
    sha256: str
    stored: str | None

    @property
    def equal(self) -> bool:
        """Whether the new replay is the stored one, bit for bit."""
        return self.sha256 == self.stored


def simulate_again(store: Store, artifacts: ArtifactStore, row: StudyRow, number: int) -> Again:
    """Simulate the policy of a trial.

    Raises:
        UnknownTrial: no such trial.
        BadInput: the trial left no policy, or its task can't be simulated again.
        ArtifactDamaged: the stored policy is missing or altered.
    """
    trial = store.trial(row.id, number)
    left = {artifact.name: artifact for artifact in store.artifacts(trial.id)}
    if POLICY not in left:
        raise BadInput(_no_policy(store, row, trial, left))
    spec = spec_of(row)
    try:
        task = load_task(spec.task.name)
        if not isinstance(task, Simulates):
            raise BadInput(
                f"replay: expected a task that can be simulated again, found that {spec.task.name} can't; "
                f"its policy is the artifact {left[POLICY].path}"
            )
        recording = task.simulate(job_of(spec, trial), artifacts.read(left[POLICY]))
    except BadJob as error:
        raise BadInput(f"replay of trial {number}: {error}") from None
    stored = left[REPLAY].sha256 if REPLAY in left else None
    return Again(trial, recording, hashlib.sha256(recording.to_bytes()).hexdigest(), stored)


def video_of(recording: Recording, kind: Literal["gif", "mp4"]) -> bytes:
    """A video of a replay. Raises `BadInput` for recordings that nobody knows how to draw."""
    from workers.physics.rendering import render_video  # noqa: PLC0415 - physics takes a second to import
    from workers.replay import Replay  # noqa: PLC0415 - as above

    if not isinstance(recording, Replay):
        raise BadInput(f"--video: expected a replay of the athlete, found a {type(recording).__name__}")
    return render_video(recording, kind=kind)


def _no_policy(store: Store, row: StudyRow, trial: TrialRow, left: Mapping[str, ArtifactRow]) -> str:
    found = f"left {', '.join(left)}" if left else "left nothing"
    message = f"replay: expected a trial with a policy, found that trial {trial.number} ({trial.state.value}) {found}"
    complete = [each.number for each in store.trials(row.id, states={TrialState.COMPLETE})]
    if complete:
        return f"{message}; complete are the trials {', '.join(map(str, complete[:10]))}"
    return f"{message}; no trial of {row.name} is complete yet"
