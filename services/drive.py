"""One driven study in memory: its record as far as the driver has written it, and what follows from it.

Everything here can be rebuilt from the trial database; nothing in it is a truth of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from services.artifacts.names import study_key
from services.dispatch.port import Assignment
from services.proposing import ProposalRequest, candidate_json, observation_json, proposal_key
from services.spec import StudySpec
from services.states import StudyState, TrialState
from services.store.port import Change, NewArtifact, StudyRow, TrialRow
from services.translate import job_of


@dataclass(slots=True)
class Live:
    """An attempt under way.

    Args:
        attempt: row id.
        token: fencing token.
        trial: number of its trial.
        pool: worker pool in which it runs.
        cpus: cores that it holds.
        seen: when a message of it last arrived, on the driver's monotonic clock.
        began: when it was dispatched, on the same clock.
        taken_up: whether a worker process has said that it runs it; before that only its start-up is awaited.
        stopping: whether it has been asked to stop.
    """

    attempt: int
    token: int
    trial: int
    pool: str
    cpus: float
    seen: float
    began: float
    taken_up: bool = False
    stopping: bool = False
    why: str = ""
    """Why it has been asked to stop, where its study goes on."""


@dataclass(frozen=True, slots=True)
class Leaving:
    """A study about to be released: the state it is left in, and why."""

    state: StudyState
    reason: str
    cancels: bool = False
    """Whether open trials are cancelled rather than kept for a later drive."""
    asked: bool = False
    """Whether people asked for it, who may think better of it before it is done."""


@dataclass(slots=True)
class Drive:
    """A study in the hands of this driver.

    Args:
        row: the study's row as last read.
        spec: its spec.
        token: the drive token: what fences this driver.
        history: finished trials in order of position.
        open: queued and running trials by number.
        next_number: number of the next trial.
    """

    row: StudyRow
    spec: StudySpec
    token: int
    history: list[TrialRow]
    open: dict[int, TrialRow]
    next_number: int
    taken_at: int = 0
    """Length of the history when this driver took the study."""
    live: dict[int, Live] = field(default_factory=dict)
    told: int = 0
    """How much of the history the strategist has been told."""
    asked: ProposalRequest | None = None
    exhausted_at: int | None = None
    """Length of the history at which the strategy had nothing more to propose."""
    not_before: dict[int, float] = field(default_factory=dict)
    """Trial numbers that back off, with the monotonic time from which they may start again."""
    hindered: dict[int, str] = field(default_factory=dict)
    """Attempts that wait for storage, and why."""
    stranded: str = ""
    """Why no host can run its trials."""
    remarked: str = ""
    """Why the study waits, as its row says."""
    leaving: Leaving | None = None
    _spent: tuple[int, int] = (0, 0)
    """Of so many trials of the history, the samples."""
    leave_by: float = math.inf
    """Monotonic time at which attempts that have not stopped yet are ended."""

    def follow(self, row: StudyRow) -> None:
        """Take note of the row as it stands: what people want, budgets, and how the study is to be run."""
        if row.spec != self.row.spec:
            self.spec = StudySpec.from_json(row.spec)
        self.row = row

    @property
    def key(self) -> str:
        """Folder of the study in the artifact store."""
        return study_key(self.row.id, self.row.name)

    @property
    def cores(self) -> float:
        """Cores its live attempts hold."""
        return sum(live.cpus for live in self.live.values())

    def spent(self) -> int:
        """Samples of the finished trials. Asked for several times in each pass, so only new ones are added up."""
        known, samples = self._spent
        if known > len(self.history):
            known = samples = 0
        samples += sum(trial.samples for trial in self.history[known:])
        self._spent = (len(self.history), samples)
        return samples

    def remaining(self) -> float:
        """How many more trials the budget allows now; infinite under a cost budget that is not spent."""
        if self.row.target_cost is not None and self.spent() >= self.row.target_cost:
            return 0
        # With stages the target is that of the search alone; the strategy knows when all of them are over.
        if self.row.target_trials is None or self.spec.stages:
            return math.inf
        return max(0, self.row.target_trials - len(self.history) - len(self.open))

    def startable(self, now: float) -> list[TrialRow]:
        """Queued trials that may start, by number. Cancelled budgets don't apply: a trial that exists is run."""
        return [
            trial
            for number, trial in sorted(self.open.items())
            if trial.state is TrialState.QUEUED and self.not_before.get(number, now) <= now
        ]

    @property
    def reserved(self) -> float:
        """Cores that the candidates it has asked for will need."""
        return self.asked.count * self.spec.resources.cpus if self.asked else 0.0

    def appetite(self, now: float) -> float:
        """How many more trials could run now: those that wait, and those that the search may be asked for."""
        room = self.spec.resources.parallel - len(self.live)
        if self.asked:
            return min(room - self.asked.count, len(self.startable(now)))
        more = 0 if self.exhausted_at == len(self.history) else self.remaining()
        return min(room, len(self.startable(now)) + more)

    def request(self, count: int) -> ProposalRequest:
        """What a proposal of `count` candidates gets to see now."""
        return ProposalRequest(
            study=self.row.id,
            start=self.told,
            history=len(self.history),
            observations=[observation_json(trial) for trial in self.history[self.told :]],
            pending=[candidate_json(trial) for _, trial in sorted(self.open.items())],
            count=count,
            rng_key=proposal_key(self.spec.seed, self.next_number),
            target_cost=self.row.target_cost,
            target_trials=self.row.target_trials,
        )

    def assignment(self, trial: TrialRow, live: Live, parent_artifacts: tuple[NewArtifact, ...]) -> Assignment:
        """What the worker of an attempt gets."""
        return Assignment(
            attempt=live.attempt,
            token=live.token,
            study_key=self.key,
            trial=trial.number,
            job=job_of(self.spec, trial).to_json(),
            pool=live.pool,
            cpus=live.cpus,
            parent_artifacts=parent_artifacts,
            iteration=trial.iteration,
        )

    def waits_for(self) -> str:
        """Why it waits, for people; empty where it doesn't."""
        return next(iter(self.hindered.values()), self.stranded)

    def remark(self, change: Change) -> None:
        """Let the study's row say why it waits, where it says something else. Raises `Refused`."""
        said = self.waits_for()
        if said != self.remarked:
            change.remark(self.row.id, self.token, said)
            self.remarked = said

    def stay(self) -> None:
        """Not leave after all. What was asked to stop comes back as it stops, and is started again."""
        self.leaving, self.leave_by = None, math.inf

    def end_of(self, trial: TrialRow) -> None:
        """A trial got its place in the history."""
        self.open.pop(trial.number, None)
        self.not_before.pop(trial.number, None)
        self.history.append(trial)

    def hopeless(self) -> str | None:
        """The reason to stop, where the last so many trials of this drive all failed by the task's own error.

        Failures before it don't count: whoever resumes a failed study has mended something.
        """
        limit = self.spec.stop_after_failures
        told = self.history[self.taken_at :]
        # Some settings diverge in any search; where all do, it is the task that gives no numbers.
        if len(told) >= 4 * limit and all(trial.state is TrialState.DIVERGED for trial in self.history):
            return (
                f"all of the first {len(self.history)} trials diverged; the newest: {told[-1].message}; "
                f"see what is wrong with the task: halma task check {self.spec.task.name}"
            )
        last = told[-limit:]
        if len(last) < limit or any(trial.state is not TrialState.FAILED for trial in last):
            return None
        return f"the last {limit} trials all failed (stop_after_failures: {limit}); the newest: {last[-1].message}"

    def finished(self) -> bool:
        """Whether nothing is open and nothing more will be proposed."""
        done = self.remaining() == 0 or self.exhausted_at == len(self.history)
        return done and not self.open and not self.asked
