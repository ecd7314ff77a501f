"""The contract between a worker and whoever hands it trials: Job in, Outcome out, Context beside it.

A training is a function of its job: the same job on the same machine type gives the same weights, bit for bit.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

JSON = Any
"""A value that `json.dumps` writes: None, bool, int, float, str, and lists and string-keyed dicts of them."""

Scalar = float | int | str
"""A parameter in natural units; strings are categories."""

Status = Literal["complete", "infeasible", "diverged", "failed"]
"""How a trial can end by itself. Interruption is no outcome: it raises `Interrupted`."""


class WorkerError(Exception):
    """Base of everything the workers raise on purpose."""


class BadJob(WorkerError):
    """The job can't be run as it stands: unknown task, wrong setting, wrong parent. Not worth a retry."""


class Interrupted(WorkerError):
    """The job stopped at a checkpoint because its context asked it to; it can be continued from there."""


@dataclass(frozen=True, slots=True)
class Job:
    """All that a training depends on.

    Args:
        study: name of the study, for logs only.
        trial: number of the trial within its study, from 0.
        task: name of a built-in task, `gymnasium:ID`, or `module:attribute`.
        task_settings: settings of the task, validated by the task.
        params: the candidate, in natural units.
        z: difficulty in [0, 1], or None where the search has no fidelity.
        training: budget, network and learner settings, validated by the task.
        seed: unsigned 64-bit; all randomness of the job flows from it.
        parent: number of the trial whose policy this one starts from, or None.
        novelty: for a training that is to find something new, `avoid` (behaviours that are known), `threshold` (how
            far from all of them earns the whole reward) and `strategies` (those that stand for one); see
            `workers.novelty`. None for any other.
    """

    study: str
    trial: int
    task: str
    params: Mapping[str, Scalar]
    seed: int
    task_settings: Mapping[str, JSON] = field(default_factory=dict)
    training: Mapping[str, JSON] = field(default_factory=dict)
    z: float | None = None
    parent: int | None = None
    novelty: Mapping[str, JSON] | None = None

    def seed_sequence(self, purpose: str) -> np.random.SeedSequence:
        """The seed for one named purpose, independent of how much any other purpose has drawn."""
        return np.random.SeedSequence((self.seed, zlib.crc32(purpose.encode())))

    def rng(self, purpose: str) -> np.random.Generator:
        """A generator of its own for one named purpose."""
        return np.random.default_rng(self.seed_sequence(purpose))

    def to_json(self) -> str:
        """Text form, for the wire."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Job:
        """The job that `to_json` wrote."""
        return cls(**json.loads(text))


@dataclass(frozen=True, slots=True)
class Cost:
    """What a job has cost since its first attempt: simulation samples (control steps) and seconds of wall clock."""

    samples: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job.

    Args:
        status: how it ended. Anything but `complete` may leave `value` and `features` None.
        value: the objective, to be maximised.
        features: the behaviour, in the coordinates that the task's `FeatureSpec` declares.
        cost: over all attempts, as kept in the checkpoint.
        message: one sentence for people, where the status is not `complete`: which iteration, which quantity.
        details: named results beside the objective (task-specific, JSON), e.g. bar height, facing, audit.
    """

    status: Status
    value: float | None = None
    features: tuple[float, ...] | None = None
    cost: Cost = field(default_factory=Cost)
    message: str = ""
    details: Mapping[str, JSON] = field(default_factory=dict)

    def to_json(self) -> str:
        """Text form, for the wire. Refuses NaN and infinities: a diverged training has no value."""
        return json.dumps(asdict(self), sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        """The outcome that `to_json` wrote."""
        fields = json.loads(text)
        fields["cost"] = Cost(**fields["cost"])
        fields["features"] = None if fields["features"] is None else tuple(fields["features"])
        return cls(**fields)


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """All that an iteration needs to go on.

    Args:
        iteration: number of finished iterations, from 1.
        tensors: weights, optimiser moments, normaliser; by dotted name.
        state: counters, curriculum, random states; JSON.
    """

    iteration: int
    tensors: Mapping[str, NDArray[Any]]
    state: Mapping[str, JSON]


class Context(Protocol):
    """What a running job may ask of its surroundings. An implementation is given to `run`."""

    def report(self, iteration: int, metrics: Mapping[str, float], cost: Cost) -> None:
        """Tell how iteration `iteration` (from 1) went.

        Called before that iteration's checkpoint is saved, so that a context can keep with the checkpoint what may
        have reached nobody. An iteration that is repeated is told again and replaces what was told of it.
        """

    def stop_requested(self) -> bool:
        """Whether to checkpoint and raise `Interrupted` at the next iteration boundary."""

    def save_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep a checkpoint durably; the one before it stays until this one is safe."""

    def load_checkpoint(self) -> Checkpoint | None:
        """The newest intact checkpoint of this trial, or None. Torn ones are set aside."""

    def save_artifact(self, name: str, data: bytes) -> None:
        """Keep a named result of the trial (`policy.safetensors`, `replay.bin`, `pose.png`); the same name replaces."""

    def parent_artifact(self, name: str) -> bytes:
        """A named result of the parent trial. Raises `BadJob` where it is missing or altered."""

    def log(self, message: str) -> None:
        """One line for the trial's log."""


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter that a task can be searched over, in natural units.

    Args:
        kind: `float`, `int`, `categorical`, or `angle` (a full circle, radians, low = -pi).
        low, high: inclusive bounds of `float` and `int`.
        log: whether the scale is logarithmic (`float`, `int`).
        choices: of `categorical`.
        unit: for axes and tables, e.g. `rad/s`.
        least, most: inclusive bounds of what the task can do at all. A study may search wider than `low` to `high`,
            which are a default, and no wider than these. None: no bound.
    """

    kind: Literal["float", "int", "categorical", "angle"]
    low: float | None = None
    high: float | None = None
    log: bool = False
    choices: tuple[str, ...] = ()
    unit: str = ""
    least: float | None = None
    most: float | None = None


@dataclass(frozen=True, slots=True)
class FeatureSpec:
    """What a behaviour is and how far two of them are apart.

    Args:
        kind: `euclidean` (vector), `circle` (one angle, rad) or `rotation` (unit quaternion, x y z w).
        names: one for each coordinate.
        low, high: range of each coordinate, `euclidean` only.
        distinct: two behaviours further apart than this (in the metric's unit) are different strategies.
        unit: for axes and tables.
    """

    kind: Literal["euclidean", "circle", "rotation"]
    names: tuple[str, ...]
    distinct: float
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    unit: str = ""


@dataclass(frozen=True, slots=True)
class TaskInfo:
    """What a search needs to know of a task.

    Args:
        name: as study files write it.
        summary: one line, for `halma tasks`.
        parameters: its own default space, by name; may be empty (then the study file must give one).
        features: its behaviour, or None where behaviour plays no part.
        has_difficulty: whether `z` means anything to it.
        trains: whether it learns a policy (so that it can be warm-started and replayed).
        seeks_novelty: whether it heeds `Job.novelty`.
        settings: the task's settings with their defaults, as JSON.
        training: the training settings with their defaults, as JSON.
    """

    name: str
    summary: str
    parameters: Mapping[str, ParameterSpec] = field(default_factory=dict)
    features: FeatureSpec | None = None
    has_difficulty: bool = False
    trains: bool = True
    seeks_novelty: bool = False
    settings: Mapping[str, JSON] = field(default_factory=dict)
    training: Mapping[str, JSON] = field(default_factory=dict)


class Task(Protocol):
    """A skill. Built-in tasks and users' own satisfy this; `workers.registry.load_task` finds them."""

    def info(self, settings: Mapping[str, JSON]) -> TaskInfo:
        """The task under these settings. Raises `BadSetting` naming the field, what was expected and found."""

    def validate(self, settings: Mapping[str, JSON], training: Mapping[str, JSON], names: Sequence[str]) -> None:
        """Refuse wrong settings, wrong training settings or parameter names the task doesn't know (`BadSetting`)."""

    def run(self, job: Job, context: Context) -> Outcome:
        """Run one trial from its newest checkpoint to its end."""


class BadSetting(BadJob):
    """A setting of a task or a training is wrong.

    Args:
        section: `task.settings`, `training` or `space`.
        field: dotted name within the section.
        message: what was expected and what was found.
    """

    def __init__(self, section: str, field: str, message: str) -> None:
        super().__init__(f"{section}.{field}: {message}")
        self.section = section
        self.field = field
        self.message = message
