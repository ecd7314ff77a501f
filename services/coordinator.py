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

from services.arrivals import Arrivals, why_stopping
from services.dispatch.port import Dispatcher, Message
from services.drive import Drive, Leaving, Live
from services.driver import DriverWatch, this_process
from services.errors import DatabaseUnavailable, HalmaError, Refused
from services.held import Effect, Held, Tell, Write
from services.proposing import ProposalRequest, Proposed, Strategist, trial_seed
from services.scheduling import Scheduler
from services.spec import StudySpec
from services.states import OPEN_TRIAL, StudyState, TrialState
from services.store.port import AttemptRow, Change, NewArtifact, NewTrial, Store, TrialRow

POLL_SECONDS = 0.25
"""How long a pass waits for messages."""

CONTROL_SECONDS = 0.5
"""How often the driver looks for what people asked for."""

BEAT_SECONDS = 3.0
"""How often the driver writes that it and its attempts live."""

WORKER_LEASE_SECONDS = 30.0
"""An attempt not heard of for so long is lost."""

START_LEASE_SECONDS = 180.0
"""The same while its worker process is still starting: importing the physics on a busy machine takes its time."""

GRACE_SECONDS = 20.0
"""How long attempts have to reach their next checkpoint when they are asked to stop."""


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
        self._leave: Leaving | None = None
        self._control_due = self._beat_due = self._adopt_due = 0.0
        self._held = Held(store, sleep, impatient=lambda: self._leave is not None, tell=tell)
        self._arrivals = Arrivals(self._held, clock, dispatcher.drop_checkpoints)
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
        self._leave = Leaving(state, reason)

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
        while self._leave is None or self._held.drives:
            if self._leave is None:
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
        self._take_proposals()
        self._keep_up()
        self._fill()
        self._release()

    def close(self) -> None:
        """Let go of the workers."""
        self._dispatcher.close()

    def _receive(self, messages: Sequence[Message]) -> None:
        self._arrivals.take(messages)
        self._control()

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
                self._send_away(drive, Leaving(StudyState.FAILED, f"the strategy failed: {answer.error}"))
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

        self._guarded(drive, write)

    @staticmethod
    def _opened(drive: Drive, rows: Sequence[TrialRow]) -> None:
        drive.open.update({row.number: row for row in rows})
        drive.next_number += len(rows)

    def _guarded(self, drive: Drive, write: Write) -> None:
        """Commit for a study; drop it where another driver has taken it over."""
        try:
            self._held.commit(write)
        except Refused as refusal:
            self._drop(drive, str(refusal))

    # -- what people asked for, leases -----------------------------------------------------------------------------

    def _keep_up(self) -> None:
        now = self._clock()
        self._control()
        if now >= self._beat_due:
            self._beat_due = now + BEAT_SECONDS
            for drive in list(self._held.drives.values()):
                self._guarded(drive, partial(self._write_beats, drive))
        for drive in list(self._held.drives.values()):
            for live in list(drive.live.values()):
                lease = WORKER_LEASE_SECONDS if live.taken_up else START_LEASE_SECONDS
                if now - live.seen > lease:
                    self._lost(drive, live, f"not heard of for {now - live.seen:.0f} s")
                elif now > drive.leave_by:
                    self._stopped_by_force(drive, live)

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
        self._guarded(drive, lambda change: self._arrivals.vanished(change, drive, live, reason))

    def _stopped_by_force(self, drive: Drive, live: Live) -> None:
        """It had its time to reach a checkpoint; its last one is what the next attempt goes on from."""
        self._dispatcher.kill(live.attempt)

        def write(change: Change) -> list[Effect]:
            why = f"{why_stopping(drive, live)} (ended after {GRACE_SECONDS:g} s)"
            row = change.preempt(live.attempt, live.token, why)
            return [lambda: self._arrivals.queued_again(drive, live, row, wait=0.0)]

        self._guarded(drive, write)

    def _control(self) -> None:
        """Follow what people asked for. Also called while an inline trial runs, hence cheap when not due."""
        if self._leave is not None:
            for drive in self._held.drives.values():
                if drive.leaving is None:
                    self._send_away(drive, self._leave)
        now = self._clock()
        if now < self._control_due:
            return
        self._control_due = now + CONTROL_SECONDS
        try:
            rows = self._store.wanted(list(self._held.drives))
        except DatabaseUnavailable:
            return
        for drive in list(self._held.drives.values()):
            row = rows.get(drive.row.id)
            if row is None:
                self._drop(drive)
                continue
            if row.drive_token != drive.token:
                self._drop(drive, "another driver has taken it over")
                continue
            drive.follow(row)
            if drive.leaving is not None and drive.leaving.asked and row.wanted == "run":
                drive.stay()
            elif drive.leaving is None and row.wanted == "pause":
                self._send_away(drive, Leaving(StudyState.PAUSED, "paused by request", asked=True))
            elif row.wanted == "cancel" and not (drive.leaving and drive.leaving.cancels):
                self._send_away(drive, Leaving(StudyState.CANCELLED, "cancelled by request", cancels=True))

    def _send_away(self, drive: Drive, leaving: Leaving) -> None:
        drive.leaving = leaving
        drive.leave_by = self._clock() + GRACE_SECONDS
        drive.asked = None
        for live in drive.live.values():
            if not live.stopping:
                live.stopping = True
                self._dispatcher.stop(live.attempt)

    def _drop(self, drive: Drive, reason: str | None = None) -> None:
        """The study is another driver's now, or deleted: end our workers, write nothing for it but what happened."""
        for live in list(drive.live.values()):
            self._dispatcher.kill(live.attempt)
            self._held.forget(drive, live)
        self._held.release(drive)
        self._strategist.close(drive.row.id)
        if reason is not None:
            self._held.note(drive.row.id, "driver_fenced", reason)

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

        self._guarded(drive, write)

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

    # -- letting studies go ----------------------------------------------------------------------------------------

    def _release(self) -> None:
        for drive in list(self._held.drives.values()):
            if drive.leaving is None:
                reason = drive.hopeless()
                if reason is not None:
                    self._send_away(drive, Leaving(StudyState.FAILED, reason))
                elif drive.finished():
                    drive.leaving = Leaving(StudyState.COMPLETE, "")
            if drive.leaving is not None and not drive.live:
                self._let_go(drive, drive.leaving)

    def _let_go(self, drive: Drive, leaving: Leaving) -> None:
        # A last look: whoever extended the study, or took a pause back, was told that its driver goes on.
        row = self._store.wanted([drive.row.id]).get(drive.row.id)
        if row is not None and row.drive_token == drive.token:
            drive.follow(row)
            thought_better = leaving.asked and row.wanted == "run"
            if thought_better or (leaving.state is StudyState.COMPLETE and not drive.finished()):
                drive.stay()
                return

        def write(change: Change) -> list[Effect]:
            if leaving.cancels:
                for trial in drive.open.values():
                    change.cancel_trial(trial.id, drive.token, leaving.reason)
            change.release_drive(drive.row.id, drive.token, leaving.state, leaving.reason)
            return [lambda: self._released(drive, cancelled=list(drive.open) if leaving.cancels else [])]

        self._guarded(drive, write)

    def _released(self, drive: Drive, cancelled: Sequence[int]) -> None:
        for number in cancelled:
            self._arrivals.sweep(drive, number)
        self._held.release(drive)
        self._strategist.close(drive.row.id)
