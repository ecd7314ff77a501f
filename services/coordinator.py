"""The coordinator: decides who runs what, and writes it down first.

It drives any number of studies over one dispatcher and one strategist. Each pass of its loop takes what arrived,
commits it, and starts what has room; nothing is dispatched before the commit that says so, and nothing is forgotten
by a worker before the commit that keeps it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from services.artifacts import ArtifactStore
from services.dispatch.port import Beat, Began, Crashed, Dispatcher, Ended, Message, Reported, Stopped, Vanished
from services.drive import Drive, Leaving, Live
from services.driver import lives, this_process
from services.errors import DatabaseUnavailable, HalmaError, Refused
from services.proposing import Proposed, Strategist, trial_seed
from services.spec import StudySpec
from services.states import OPEN_TRIAL, StudyState, TrialState
from services.store.port import Change, NewArtifact, NewTrial, Result, Store, StudyRow, TrialRow
from workers.contracts import Outcome

POLL_SECONDS = 0.25
"""How long a pass waits for messages."""

CONTROL_SECONDS = 0.5
"""How often the driver looks for what people asked for."""

BEAT_SECONDS = 3.0
"""How often the driver writes that it and its attempts live."""

DRIVER_LEASE_SECONDS = 15.0
"""A driver on another host whose beat has not moved for so long counts as dead."""

WORKER_LEASE_SECONDS = 30.0
"""An attempt not heard of for so long is lost."""

START_LEASE_SECONDS = 180.0
"""The same while its worker process is still starting: importing the physics on a busy machine takes its time."""

GRACE_SECONDS = 20.0
"""How long attempts have to reach their next checkpoint when they are asked to stop."""

Effect = Callable[[], None]
"""What happens in memory once a commit is safe."""


class Coordinator:
    """Drives studies. Not thread-safe, but for `leave`.

    Args:
        store: the trial database.
        artifacts: where trials leave their files.
        dispatcher: runs attempts.
        strategist: computes proposals.
        clock: monotonic seconds; a parameter so that tests can jump it.
        sleep: waits; likewise.
    """

    def __init__(
        self,
        store: Store,
        artifacts: ArtifactStore,
        dispatcher: Dispatcher,
        strategist: Strategist,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._store = store
        self._artifacts = artifacts
        self._dispatcher = dispatcher
        self._strategist = strategist
        self._clock = clock
        self._sleep = sleep
        self._drives: dict[int, Drive] = {}
        self._study_of: dict[int, int] = {}
        self._identity = this_process()
        self._leave: Leaving | None = None
        self._control_due = self._beat_due = self._adopt_due = 0.0
        self._watched: dict[int, tuple[tuple[int, int], float]] = {}

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
        if row.driver is not None and (take_over or self._is_dead(name)):
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
        )
        self._drives[row.id] = drive
        try:
            self._strategist.open(row.id, row.spec)
        except BaseException:
            del self._drives[row.id]
            with self._store.transaction() as change:
                change.release_drive(row.id, token, StudyState.PAUSED, "its strategy could not be made")
            raise

    def _is_dead(self, name: str) -> bool:
        """Whether a study's driver is gone: seen at once on this host, by its still beat on another."""
        while True:
            row = self._store.study(name)
            dead = self._looks_dead(row)
            if dead is not None:
                return dead
            self._sleep(0.2)

    def _looks_dead(self, row: StudyRow) -> bool | None:
        """Whether a study's driver is gone; None while its beat has to be watched for longer."""
        if row.driver is None:
            return False
        alive = lives(row.driver)
        if alive is not None:
            return not alive
        now = self._clock()
        seen = (row.drive_token, row.drive_beat)
        watched = self._watched.get(row.id)
        if watched is None or watched[0] != seen:
            first_look = watched is None or watched[0][0] != row.drive_token
            self._watched[row.id] = (seen, now)
            return None if first_look else False
        return True if now - watched[1] > DRIVER_LEASE_SECONDS else None

    def leave(self, state: StudyState, reason: str) -> None:
        """Stop at the next checkpoints and release every study in `state`. May be called from a signal handler."""
        self._leave = Leaving(state, reason)

    def driven(self) -> list[str]:
        """Names of the studies in its hands."""
        return [drive.row.name for drive in self._drives.values()]

    # -- the loop --------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Drive until every study is released."""
        while self._drives:
            self.step()

    def serve(self) -> None:
        """Drive every study that wants to run, until asked to leave."""
        while self._leave is None or self._drives:
            if self._leave is None:
                self._adopt()
            self.step()

    def _adopt(self) -> None:
        """Take the studies that nobody drives, or whose driver is gone."""
        now = self._clock()
        if now < self._adopt_due:
            return
        self._adopt_due = now + CONTROL_SECONDS
        for row in self._store.studies():
            orphaned = row.state is StudyState.RUNNING and row.id not in self._drives and self._looks_dead(row)
            if row.wanted == "run" and (row.state is StudyState.QUEUED or orphaned):
                try:
                    self.take(row.name)
                except HalmaError as error:
                    self._note(row.id, "not_taken", str(error))

    def _note(self, study_id: int, kind: str, reason: str) -> None:
        def write(change: Change) -> list[Effect]:
            change.note(kind, study_id=study_id, reason=reason)
            return []

        self._commit(write)

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

    # -- writing ---------------------------------------------------------------------------------------------------

    def _commit(self, write: Callable[[Change], list[Effect]], *, again: bool = False) -> None:
        """Commit, then let the effects happen.

        A database that goes away leaves open whether the commit was made. It is waited for (workers go on meanwhile),
        and what is in memory is read anew. Then the write is made `again` where its transitions are safe to repeat
        (a message that was committed is refused the second time); otherwise the next pass decides anew.

        Raises:
            DatabaseUnavailable: it is away, and the driver has been asked to leave.
        """
        while True:
            try:
                with self._store.transaction() as change:
                    effects = write(change)
            except DatabaseUnavailable as error:
                self._wait_for_the_record(error)
                if not again:
                    return
            else:
                break
        for effect in effects:
            effect()

    def _wait_for_the_record(self, trouble: DatabaseUnavailable) -> None:
        pause = 0.1
        while True:
            if self._leave is not None:
                raise trouble
            self._sleep(pause)
            pause = min(2 * pause, 5.0)
            try:
                for drive in list(self._drives.values()):
                    self._read_anew(drive)
            except DatabaseUnavailable as error:
                trouble = error
            else:
                return

    def _read_anew(self, drive: Drive) -> None:
        """Make the view of a study agree with its record."""
        row = self._store.study(drive.row.name)
        if row.id != drive.row.id or row.drive_token != drive.token:
            return  # the next look at what people want finds out, and drops it
        drive.row, drive.asked = row, None
        drive.history = self._store.history(row.id)
        drive.open = {trial.number: trial for trial in self._store.trials(row.id, states=OPEN_TRIAL)}
        drive.next_number = sum(row.counts.values())
        for live in list(drive.live.values()):
            if live.trial not in drive.open:
                self._forget(drive, live)
        held = {live.attempt for live in drive.live.values()}
        with self._store.transaction() as change:
            for trial in drive.open.values():
                if trial.state is TrialState.RUNNING:
                    newest = self._store.attempts(trial.id)[-1]
                    if newest.id not in held:
                        # Its start was committed, but the worker was never told.
                        drive.open[trial.number] = change.preempt(newest.id, newest.token, "never dispatched")

    def _receive(self, messages: Sequence[Message]) -> None:
        """Messages that arrived together share one commit."""

        def write(change: Change) -> list[Effect]:
            effects: list[Effect] = []
            for message in messages:
                try:
                    effects += self._apply(change, message)
                except Refused as refusal:
                    study = self._study_of.get(message.attempt)
                    change.note(
                        "refused", study_id=study, attempt=message.attempt, token=message.token, reason=str(refusal)
                    )
            return effects

        if any(self._worth_a_commit(message) for message in messages):
            self._commit(write, again=True)
        self._control()

    def _worth_a_commit(self, message: Message) -> bool:
        """A beat of a live attempt only moves the driver's own clock; it is written with the driver's beat."""
        live = self._live(message)
        if live is not None:
            live.seen = self._clock()
            live.taken_up = True
        return live is None or not isinstance(message, Beat)

    def _live(self, message: Message) -> Live | None:
        study = self._study_of.get(message.attempt)
        drive = None if study is None else self._drives.get(study)
        return None if drive is None else drive.live.get(message.attempt)

    def _apply(self, change: Change, message: Message) -> list[Effect]:
        """Write one message; returns what then happens in memory. Raises `Refused` for a fenced attempt."""
        live = self._live(message)
        if live is None or live.token != message.token:
            # Not ours, or no longer: the store is asked all the same, so that the refusal is its own.
            change.beat(message.attempt, message.token)
            raise Refused(f"attempt {message.attempt} is not driven here")
        drive = self._drives[self._study_of[message.attempt]]
        effects: list[Effect] = []
        match message:
            case Began(host=host, pid=pid):
                change.began(message.attempt, message.token, host=host, pid=pid)
            case Beat():
                change.beat(message.attempt, message.token)
            case Reported():
                change.report(
                    message.attempt,
                    message.token,
                    iteration=message.iteration,
                    metrics=message.metrics,
                    samples=message.samples,
                    seconds=message.seconds,
                )
            case Ended():
                row = change.finish(message.attempt, message.token, _result(message))
                effects = [lambda: self._ended(drive, live, row)]
            case Stopped():
                row = change.preempt(message.attempt, message.token, self._why_stopping(drive))
                effects = [lambda: self._queued_again(drive, live, row, wait=0.0)]
            case Crashed():
                effects = self._crashed(change, drive, live, drive.open[live.trial], message)
            case Vanished():
                effects = self._vanished(change, drive, live, message.reason)
        return effects

    def _crashed(self, change: Change, drive: Drive, live: Live, trial: TrialRow, message: Crashed) -> list[Effect]:
        if message.retry and trial.retries < drive.spec.retries.limit:
            row = change.fail(live.attempt, live.token, message.message)
            return [lambda: self._queued_again(drive, live, row, wait=_backoff(drive, row))]
        result = Result(TrialState.FAILED, samples=trial.samples, seconds=trial.seconds, message=message.message)
        row = change.finish(live.attempt, live.token, result)
        return [lambda: self._ended(drive, live, row)]

    def _vanished(self, change: Change, drive: Drive, live: Live, reason: str) -> list[Effect]:
        row = change.lose(live.attempt, live.token, reason)
        if row.retries <= drive.spec.retries.limit:
            return [lambda: self._queued_again(drive, live, row, wait=_backoff(drive, row))]
        final = change.give_up(row.id, drive.token, f"its worker was lost {row.retries} times; the last time: {reason}")
        return [lambda: self._ended(drive, live, final)]

    def _ended(self, drive: Drive, live: Live, row: TrialRow) -> None:
        self._forget(drive, live)
        drive.end_of(row)

    def _queued_again(self, drive: Drive, live: Live, row: TrialRow, *, wait: float) -> None:
        self._forget(drive, live)
        drive.open[row.number] = row
        drive.not_before[row.number] = self._clock() + wait

    def _forget(self, drive: Drive, live: Live) -> None:
        drive.live.pop(live.attempt, None)
        self._study_of.pop(live.attempt, None)

    @staticmethod
    def _why_stopping(drive: Drive) -> str:
        return drive.leaving.reason if drive.leaving else "asked to stop"

    # -- proposals -------------------------------------------------------------------------------------------------

    def _take_proposals(self) -> None:
        answers = [(self._drives.get(answer.study), answer) for answer in self._strategist.answers()]
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
                self._record(drive, answer)

    def _record(self, drive: Drive, answer: Proposed) -> None:
        """Make trials of candidates: from the commit on they exist, whatever happens to anybody."""
        if not answer.candidates:
            drive.exhausted_at = len(drive.history)
            return
        trials = [
            NewTrial(
                params=candidate["params"],
                seed=trial_seed(drive.spec.seed, drive.next_number + place),
                z=candidate["z"],
                warm_start=candidate["warm_start"],
                info=candidate["info"],
            )
            for place, candidate in enumerate(answer.candidates)
        ]

        def write(change: Change) -> list[Effect]:
            rows = change.propose(
                drive.row.id,
                drive.token,
                strategy=drive.spec.search.strategy,
                history=len(drive.history),
                pending=sorted(drive.open),
                rng_key=drive.request(len(trials)).rng_key,
                seconds=answer.seconds,
                trials=trials,
                info={"settings": drive.spec.search.settings},
            )
            return [lambda: self._opened(drive, rows)]

        self._guarded(drive, write)

    @staticmethod
    def _opened(drive: Drive, rows: Sequence[TrialRow]) -> None:
        drive.open.update({row.number: row for row in rows})
        drive.next_number += len(rows)

    def _guarded(self, drive: Drive, write: Callable[[Change], list[Effect]]) -> None:
        """Commit for a study; being refused there means that another driver has taken it over."""
        try:
            self._commit(write)
        except Refused as refusal:
            self._drop(drive, str(refusal))

    # -- what people asked for, leases -----------------------------------------------------------------------------

    def _keep_up(self) -> None:
        now = self._clock()
        self._control()
        if now >= self._beat_due:
            self._beat_due = now + BEAT_SECONDS
            for drive in list(self._drives.values()):
                self._guarded(drive, lambda change, drive=drive: self._write_beats(change, drive))  # type: ignore[misc]
        for drive in list(self._drives.values()):
            for live in list(drive.live.values()):
                lease = WORKER_LEASE_SECONDS if live.taken_up else START_LEASE_SECONDS
                if now - live.seen > lease:
                    self._lost(drive, live, f"not heard of for {now - live.seen:.0f} s")
                elif now > drive.leave_by:
                    self._stopped_by_force(drive, live)

    @staticmethod
    def _write_beats(change: Change, drive: Drive) -> list[Effect]:
        change.beat_drive(drive.row.id, drive.token)
        for live in drive.live.values():
            change.beat(live.attempt, live.token)
        return []

    def _lost(self, drive: Drive, live: Live, reason: str) -> None:
        self._dispatcher.kill(live.attempt)
        self._guarded(drive, lambda change: self._vanished(change, drive, live, reason))

    def _stopped_by_force(self, drive: Drive, live: Live) -> None:
        """It had its time to reach a checkpoint; its last one is what the next attempt goes on from."""
        self._dispatcher.kill(live.attempt)

        def write(change: Change) -> list[Effect]:
            row = change.preempt(
                live.attempt, live.token, f"{self._why_stopping(drive)} (ended after {GRACE_SECONDS:g} s)"
            )
            return [lambda: self._queued_again(drive, live, row, wait=0.0)]

        self._guarded(drive, write)

    def _control(self) -> None:
        """Follow what people asked for. Also called while an inline trial runs, hence cheap when not due."""
        if self._leave is not None:
            for drive in self._drives.values():
                if drive.leaving is None:
                    self._send_away(drive, self._leave)
        now = self._clock()
        if now < self._control_due:
            return
        self._control_due = now + CONTROL_SECONDS
        try:
            rows = self._store.wanted(list(self._drives))
        except DatabaseUnavailable:
            return
        for drive in list(self._drives.values()):
            row = rows.get(drive.row.id)
            if row is None or row.drive_token != drive.token:
                self._drop(drive, "another driver has taken it over" if row else "the study was deleted")
                continue
            drive.row = row
            if drive.leaving is None and row.wanted == "pause":
                self._send_away(drive, Leaving(StudyState.PAUSED, "paused by request"))
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

    def _drop(self, drive: Drive, reason: str) -> None:
        """The study is another driver's now: end our workers, write nothing for it but what happened."""
        for live in list(drive.live.values()):
            self._dispatcher.kill(live.attempt)
            self._forget(drive, live)
        self._drives.pop(drive.row.id, None)
        self._strategist.close(drive.row.id)
        self._note(drive.row.id, "driver_fenced", reason)

    # -- starting trials -------------------------------------------------------------------------------------------

    def _fill(self) -> None:
        """Start what may start, the most deserving study first: by priority, then by fewest cores held."""
        now = self._clock()
        for drive in sorted(self._drives.values(), key=lambda drive: (-drive.row.priority, drive.cores, drive.row.id)):
            if drive.leaving is not None:
                continue
            slots = self._slots(drive)
            starting = drive.startable(now)[:slots]
            if starting:
                self._start(drive, starting)
            count = drive.wants(slots - len(starting), now)
            if count > 0:
                drive.asked = drive.request(count)
                self._strategist.ask(drive.asked)

    def _slots(self, drive: Drive) -> int:
        by_study = drive.spec.resources.parallel - len(drive.live)
        by_pool = self._dispatcher.free(drive.row.pool) // drive.spec.resources.cpus
        return int(max(0, min(by_study, by_pool)))

    def _start(self, drive: Drive, trials: Sequence[TrialRow]) -> None:
        parents = {trial.number: self._parent_artifacts(drive, trial) for trial in trials}

        def write(change: Change) -> list[Effect]:
            effects: list[Effect] = []
            for trial in trials:
                attempt = change.start(trial.id, drive.token, worker=drive.row.pool)
                effects.append(
                    lambda trial=trial, attempt=attempt: self._dispatch(
                        drive, trial, attempt.id, attempt.token, parents[trial.number]
                    )
                )  # type: ignore[misc]
            return effects

        self._guarded(drive, write)

    def _parent_artifacts(self, drive: Drive, trial: TrialRow) -> tuple[NewArtifact, ...]:
        if trial.warm_start is None:
            return ()
        parent = self._store.trial(drive.row.id, trial.warm_start)
        rows = self._store.artifacts(parent.id)
        return tuple(NewArtifact(row.name, row.path, row.sha256, row.size) for row in rows)

    def _dispatch(
        self, drive: Drive, trial: TrialRow, attempt: int, token: int, parents: tuple[NewArtifact, ...]
    ) -> None:
        now = self._clock()
        live = Live(attempt=attempt, token=token, trial=trial.number, seen=now, began=now)
        drive.live[attempt] = live
        drive.open[trial.number] = self._store.trial(drive.row.id, trial.number)
        self._study_of[attempt] = drive.row.id
        self._dispatcher.start(drive.assignment(trial, live, parents))

    # -- letting studies go ----------------------------------------------------------------------------------------

    def _release(self) -> None:
        for drive in list(self._drives.values()):
            if drive.leaving is None:
                reason = drive.hopeless()
                if reason is not None:
                    self._send_away(drive, Leaving(StudyState.FAILED, reason))
                elif drive.finished():
                    drive.leaving = Leaving(StudyState.COMPLETE, "")
            if drive.leaving is not None and not drive.live:
                self._let_go(drive, drive.leaving)

    def _let_go(self, drive: Drive, leaving: Leaving) -> None:
        def write(change: Change) -> list[Effect]:
            if leaving.cancels:
                for trial in drive.open.values():
                    change.cancel_trial(trial.id, drive.token, leaving.reason)
            change.release_drive(drive.row.id, drive.token, leaving.state, leaving.reason)
            return [lambda: self._released(drive)]

        self._guarded(drive, write)

    def _released(self, drive: Drive) -> None:
        self._drives.pop(drive.row.id, None)
        self._strategist.close(drive.row.id)


def _backoff(drive: Drive, trial: TrialRow) -> float:
    """Seconds to wait before a retry: doubling, at most a minute."""
    return min(60.0, drive.spec.retries.backoff_seconds * 2.0 ** max(0, trial.retries - 1))


def _result(message: Ended) -> Result:
    """The worker's outcome in the store's words."""
    outcome = Outcome.from_json(message.outcome)
    return Result(
        state=TrialState(outcome.status),
        value=outcome.value,
        features=outcome.features,
        samples=outcome.cost.samples,
        seconds=outcome.cost.seconds,
        message=outcome.message,
        details=outcome.details,
        artifacts=message.artifacts,
    )
