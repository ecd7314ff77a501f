"""The coordinator: decides who runs what, and writes it down first.

It drives any number of studies over one dispatcher and one strategist. Each pass of its loop takes what arrived,
commits it, and starts what has room; nothing is dispatched before the commit that says so, and nothing is forgotten
by a worker before the commit that keeps it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from services.arrivals import Arrivals
from services.departures import CONTROL_SECONDS, Departures
from services.dispatch.port import Dispatcher, Message
from services.drive import Drive, Leaving, Live
from services.driver import DriverWatch, this_process
from services.errors import DatabaseUnavailable, HalmaError
from services.held import Effect, Held, Tell
from services.proposing import ProposalRequest, Proposed, Strategist, trial_seed
from services.scheduling import Scheduler
from services.spec import StudySpec
from services.states import OPEN_TRIAL, StudyState, TrialState
from services.store.port import AttemptRow, Change, NewArtifact, NewTrial, Store, TrialRow

POLL_SECONDS = 0.25
"""How long a pass waits for messages."""

BEAT_SECONDS = 3.0
"""How often the driver writes that it and its attempts live."""

WORKER_LEASE_SECONDS = 30.0
"""An attempt not heard of for so long is lost."""

START_LEASE_SECONDS = 180.0
"""The same while its worker process is still starting: importing the physics on a busy machine takes its time."""

MOST_DOUBLINGS = 4
"""Of the start's lease, after as many retries."""


class Coordinator:
    """Drives studies. Not thread-safe, but for `leave`.

    Args:
        store: the trial database.
        dispatcher: runs attempts.
        strategist: computes proposals.
        clock: monotonic seconds; a parameter so that tests can jump it.
        sleep: waits; likewise.
        tell: is told what people should know at once.
    """

    def __init__(
        self,
        store: Store,
        dispatcher: Dispatcher,
        strategist: Strategist,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        tell: Tell = lambda _: None,
    ) -> None:
        self._store = store
        self._dispatcher = dispatcher
        self._strategist = strategist
        self._clock = clock
        self._identity = this_process()
        self._beat_due = self._adopt_due = 0.0
        self._listened = clock()
        self._held = Held(store, sleep, clock, impatient=lambda: self._departures.leave is not None, tell=tell)
        self._arrivals = Arrivals(self._held, clock, dispatcher.drop_checkpoints)
        self._departures = Departures(store, self._held, dispatcher, strategist, self._arrivals, clock)
        self._scheduler = Scheduler(dispatcher)
        self._watch = DriverWatch(store, clock, sleep)

    # -- taking and leaving studies --------------------------------------------------------------------------------

    def take(self, name: str, *, take_over: bool = False) -> None:
        """Become the driver of a study, at once where nobody drives it or its driver is seen to be dead.

        Args:
            name: the study.
            take_over: fence off a living driver too.

        Raises:
            StudyDriven: another driver holds it, and lives as far as can be seen.
        """
        row = self._store.study(name)
        over = None
        if row.driver is not None and (take_over or self._watch.is_dead(name)):
            over = row.drive_token
        with self._store.transaction() as change:
            token = change.drive(name, self._identity, take_over_from=over)
        row = self._store.study(name)
        opened = self._store.trials(row.id, states=OPEN_TRIAL)
        history = self._store.history(row.id)
        drive = Drive(
            row=row,
            spec=StudySpec.from_json(row.spec),
            token=token,
            history=history,
            open={trial.number: trial for trial in opened},
            next_number=sum(row.counts.values()),
            taken_at=len(history),
        )
        self._held.drives[row.id] = drive
        try:
            self._dispatcher.open(drive.key, drive.spec.task.name)
            self._strategist.open(row.id, row.spec)
        except BaseException as error:
            del self._held.drives[row.id]
            with self._store.transaction() as change:
                change.release_drive(row.id, token, StudyState.PAUSED, f"it could not be made ready: {error}")
            raise

    def leave(self, state: StudyState, reason: str) -> None:
        """Stop at the next checkpoints and release every study in `state`. May be called from a signal handler."""
        self._departures.leave = Leaving(state, reason)

    def driven(self) -> list[str]:
        """Names of the studies in its hands."""
        return [drive.row.name for drive in self._held.drives.values()]

    # -- the loop --------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Drive until every study is released."""
        while self._held.drives:
            self._patient(self.step)

    def serve(self) -> None:
        """Drive every study that wants to run, until asked to leave."""
        while self._departures.leave is None or self._held.drives:
            if self._departures.leave is None:
                self._patient(self._adopt)
            self._patient(self.step)

    def _patient(self, act: Callable[[], None]) -> None:
        """Do it; a database that is away meanwhile is waited for, and the next pass decides anew.

        Raises:
            DatabaseUnavailable: it is away, and the driver has been asked to leave.
        """
        try:
            act()
        except DatabaseUnavailable as error:
            self._held.wait(error)

    def trouble(self) -> str:
        """Why nothing can be recorded now; empty where it can."""
        return self._held.trouble

    def _adopt(self) -> None:
        """Take the studies that nobody drives, or whose driver is gone."""
        now = self._clock()
        if now < self._adopt_due:
            return
        self._adopt_due = now + CONTROL_SECONDS
        for row in self._store.studies():
            if row.id in self._held.drives or row.wanted != "run":
                continue
            orphaned = row.state is StudyState.RUNNING and self._watch.looks_dead(row)
            if row.state is StudyState.QUEUED or orphaned:
                try:
                    self.take(row.name)
                except DatabaseUnavailable:
                    raise
                except HalmaError as error:
                    self._held.note(row.id, "not_taken", str(error))

    def step(self, timeout: float = POLL_SECONDS) -> None:
        """One pass: take what arrived, follow what people asked for, start what has room."""
        self._dispatcher.poll(self._receive, timeout)
        self._listened = self._clock()
        self._take_proposals()
        self._keep_up()
        self._fill()
        self._departures.release()

    def close(self) -> None:
        """Let go of the workers."""
        self._dispatcher.close()

    def _receive(self, messages: Sequence[Message]) -> None:
        self._arrivals.take(messages)
        self._departures.control()

    # -- proposals -------------------------------------------------------------------------------------------------

    def _take_proposals(self) -> None:
        answers = [(self._held.drives.get(answer.study), answer) for answer in self._strategist.answers()]
        for drive, answer in answers:
            if drive is None or drive.asked is None:
                continue
            asked, drive.asked = drive.asked, None
            if answer.missing_from is not None:
                drive.told = answer.missing_from
            elif answer.error:
                self._departures.send_away(drive, Leaving(StudyState.FAILED, f"the strategy failed: {answer.error}"))
            elif drive.leaving is None:
                drive.told = asked.history
                self._record(drive, asked, answer)

    def _record(self, drive: Drive, asked: ProposalRequest, answer: Proposed) -> None:
        """Make trials of candidates: from the commit on they exist, whatever happens to anybody."""
        if not answer.candidates:
            drive.exhausted_at = asked.history
            return
        trials = [
            NewTrial(
                params=candidate["params"],
                seed=trial_seed(drive.spec.seed, drive.next_number + place),
                z=candidate["z"],
                warm_start=candidate["warm_start"],
                stage=candidate["stage"],
                info=candidate["info"],
            )
            for place, candidate in enumerate(answer.candidates)
        ]

        def write(change: Change) -> list[Effect]:
            rows = change.propose(
                drive.row.id,
                drive.token,
                strategy=drive.spec.search.strategy,
                history=asked.history,
                pending=[candidate["number"] for candidate in asked.pending],
                rng_key=asked.rng_key,
                seconds=answer.seconds,
                trials=trials,
                info={"settings": drive.spec.search.settings, "target_cost": asked.target_cost},
            )
            return [lambda: self._opened(drive, rows)]

        self._departures.guarded(drive, write)

    @staticmethod
    def _opened(drive: Drive, rows: Sequence[TrialRow]) -> None:
        drive.open.update({row.number: row for row in rows})
        drive.next_number += len(rows)

    # -- what people asked for, leases -----------------------------------------------------------------------------

    def _keep_up(self) -> None:
        now = self._clock()
        self._departures.control()
        if now >= self._beat_due:
            self._beat_due = now + BEAT_SECONDS
            for drive in list(self._held.drives.values()):
                self._departures.guarded(drive, partial(self._write_beats, drive))
        for drive in list(self._held.drives.values()):
            for live in list(drive.live.values()):
                lease = _lease(drive, live)
                # Until the last time that anybody listened: a driver that was itself stopped since knows nothing.
                silence = self._listened - live.seen
                if silence > lease:
                    self._lost(drive, live, f"not heard of for {silence:.0f} s")
                elif now > drive.leave_by:
                    self._departures.stopped_by_force(drive, live)

    @staticmethod
    def _write_beats(drive: Drive, change: Change) -> list[Effect]:
        change.beat_drive(drive.row.id, drive.token)
        for live in drive.live.values():
            change.beat(live.attempt, live.token)
        # Who waited may have ended without a word, and whether there is a host nobody says at all.
        drive.remark(change)
        return []

    def _lost(self, drive: Drive, live: Live, reason: str) -> None:
        self._dispatcher.kill(live.attempt)
        self._departures.guarded(drive, lambda change: self._arrivals.vanished(change, drive, live, reason))

    # -- starting trials -------------------------------------------------------------------------------------------

    def _fill(self) -> None:
        """Start what may start, ask for what could, and make room for what is more urgent."""
        now, drives = self._clock(), list(self._held.drives.values())
        self._scheduler.charge(drives, now)
        shares, left = self._scheduler.hand_out(drives, now)
        given = {drive.row.id: slots for drive, slots in shares}
        for _, live, why in self._scheduler.displaced(drives, given, left, now):
            live.stopping, live.why = True, why
            self._dispatcher.stop(live.attempt)
        for drive, slots in shares:
            starting = drive.startable(now)[:slots]
            if starting:
                self._start(drive, starting)
            if slots > len(starting):
                drive.asked = drive.request(slots - len(starting))
                self._strategist.ask(drive.asked)
        for drive in drives:
            drive.stranded = self._scheduler.stranded(drive, now)
        self._scheduler.hold(drives)

    def _start(self, drive: Drive, trials: Sequence[TrialRow]) -> None:
        parents = {trial.number: self._parent_artifacts(drive, trial) for trial in trials}

        def start(change: Change, trial: TrialRow) -> Effect:
            attempt = change.start(trial.id, drive.token, worker=drive.row.pool)
            return lambda: self._dispatch(drive, trial, attempt, parents[trial.number])

        def write(change: Change) -> list[Effect]:
            return [start(change, trial) for trial in trials]

        self._departures.guarded(drive, write)

    def _parent_artifacts(self, drive: Drive, trial: TrialRow) -> tuple[NewArtifact, ...]:
        if trial.warm_start is None:
            return ()
        parent = self._store.trial(drive.row.id, trial.warm_start)
        rows = self._store.artifacts(parent.id)
        return tuple(NewArtifact(row.name, row.path, row.sha256, row.size) for row in rows)

    def _dispatch(self, drive: Drive, trial: TrialRow, attempt: AttemptRow, parents: tuple[NewArtifact, ...]) -> None:
        now = self._clock()
        live = Live(
            attempt=attempt.id,
            token=attempt.token,
            trial=trial.number,
            pool=drive.row.pool,
            cpus=drive.spec.resources.cpus,
            seen=now,
            began=now,
        )
        drive.live[attempt.id] = live
        # Known without asking: once a start is committed, nothing may keep the worker from hearing of it.
        drive.open[trial.number] = replace(trial, state=TrialState.RUNNING, attempts=attempt.number)
        self._held.study_of[attempt.id] = drive.row.id
        self._dispatcher.start(drive.assignment(trial, live, parents))


def _lease(drive: Drive, live: Live) -> float:
    """Seconds of silence after which an attempt is lost.

    A start that took too long is given twice the time when it is tried again: where the machine is slow for everybody,
    ending it at the same moment again would get nowhere.
    """
    if live.taken_up:
        return WORKER_LEASE_SECONDS
    return START_LEASE_SECONDS * 2.0 ** min(MOST_DOUBLINGS, drive.open[live.trial].retries)
