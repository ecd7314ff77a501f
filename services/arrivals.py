"""What arrives from workers, written down: each message becomes a guarded transition, and then a change of view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from services.dispatch.port import Beat, Began, Crashed, Ended, Hindered, Message, Reported, Stopped, Vanished
from services.drive import Drive, Live
from services.errors import Refused
from services.held import Effect, Held
from services.states import AttemptState, TrialState
from services.store.port import Change, Result, TrialRow
from workers.contracts import Outcome


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Takes messages of workers into the record.

    Args:
        held: the driven studies.
        clock: monotonic seconds.
        drop_checkpoints: called with the study's folder and the number of a trial that has ended.
    """

    held: Held
    clock: Callable[[], float]
    drop_checkpoints: Callable[[str, int], None]

    def take(self, messages: Sequence[Message]) -> None:
        """Write messages that arrived together, in one commit. A fenced attempt's are refused, and that is noted."""

        def write(change: Change) -> list[Effect]:
            effects: list[Effect] = []
            for message in messages:
                try:
                    effects += self._apply(change, message)
                except Refused as refusal:
                    study = self.held.study_of.get(message.attempt)
                    change.note(
                        "refused", study_id=study, attempt=message.attempt, token=message.token, reason=str(refusal)
                    )
            return effects

        if [message for message in messages if self._worth_a_commit(message)]:
            self.held.commit(write, again=True)

    def _worth_a_commit(self, message: Message) -> bool:
        """A beat of a live attempt only moves the driver's own clock; it is written with the driver's beat."""
        found = self.held.live(message)
        if found is None:
            return True
        live = found[1]
        live.seen = self.clock()
        live.taken_up = True
        if isinstance(message, Hindered):
            return message.reason != live_hindrance(found)
        return not isinstance(message, Beat)

    def _apply(self, change: Change, message: Message) -> list[Effect]:
        """Write one message; returns what then happens in memory. Raises `Refused` for a fenced attempt."""
        found = self.held.live(message)
        if found is None:
            # The store is asked all the same, so that the refusal and its reason are its own.
            change.beat(message.attempt, message.token)
            raise Refused(f"attempt {message.attempt} is not driven here")
        drive, live = found
        effects: list[Effect] = []
        match message:
            case Began(host=host, pid=pid):
                change.began(message.attempt, message.token, host=host, pid=pid)
            case Beat():
                change.beat(message.attempt, message.token)
            case Hindered(reason=reason):
                self._hindered(change, drive, live, reason)
            case Reported():
                change.report(
                    message.attempt,
                    message.token,
                    iteration=message.iteration,
                    metrics=message.metrics,
                    samples=message.samples,
                    seconds=message.seconds,
                )
                # At once, not after the commit: the failure may be the next message of the same batch.
                self._progressed(drive, live, message)
            case Ended():
                row = change.finish(message.attempt, message.token, _result(message))
                effects = [lambda: self._ended(drive, live, row)]
            case Stopped():
                row = change.preempt(message.attempt, message.token, why_stopping(drive, live))
                effects = [lambda: self.queued_again(drive, live, row, wait=0.0)]
            case Crashed():
                effects = self._crashed(change, drive, live, drive.open[live.trial], message)
            case Vanished():
                effects = self.vanished(change, drive, live, message.reason)
        return effects

    @staticmethod
    def _hindered(change: Change, drive: Drive, live: Live, reason: str) -> None:
        """The study shows that it waits, and why, for as long as any of its attempts does."""
        drive.hindered = {**drive.hindered, live.attempt: reason}
        if not reason:
            del drive.hindered[live.attempt]
        drive.remark(change)

    @staticmethod
    def _progressed(drive: Drive, live: Live, report: Reported) -> None:
        """What a trial has cost so far is kept in view: a failure is recorded with it."""
        trial = drive.open[live.trial]
        drive.open[live.trial] = replace(
            trial, iteration=report.iteration, samples=report.samples, seconds=report.seconds
        )

    def _crashed(self, change: Change, drive: Drive, live: Live, trial: TrialRow, message: Crashed) -> list[Effect]:
        failed = [each for each in self.held.store.attempts(trial.id) if each.state is AttemptState.FAILED]
        if message.retry and len(failed) < drive.spec.retries.limit and trial.retries < drive.spec.retries.in_all:
            row = change.fail(live.attempt, live.token, message.message)
            return [lambda: self.queued_again(drive, live, row, wait=_backoff(drive, len(failed) + 1))]
        result = Result(TrialState.FAILED, samples=trial.samples, seconds=trial.seconds, message=message.message)
        row = change.finish(live.attempt, live.token, result)
        return [lambda: self._ended(drive, live, row)]

    def vanished(self, change: Change, drive: Drive, live: Live, reason: str) -> list[Effect]:
        """Write that a worker is gone. Its trial is retried, and given up where the last attempts got nowhere.

        An attempt that came further than the one before it was stopped by the world, not by its trial: on hosts that
        come and go, a long training may be interrupted many times. But not for ever: a trial that kills its worker
        after each checkpoint comes further, too.
        """
        row = change.lose(live.attempt, live.token, reason)
        fruitless = self._fruitless(row, live)
        if fruitless <= drive.spec.retries.limit and row.retries <= drive.spec.retries.in_all:
            return [lambda: self.queued_again(drive, live, row, wait=_backoff(drive, fruitless))]
        further = f", though it came further each time (retries.total: {drive.spec.retries.in_all})"
        message = f"its worker was lost {row.retries} times{further if fruitless == 0 else ''}; the last time: {reason}"
        final = change.give_up(row.id, drive.token, message)
        return [lambda: self._ended(drive, live, final)]

    def _fruitless(self, row: TrialRow, live: Live) -> int:
        """How many attempts, this one the last, have ended badly since the trial last came further."""
        since = [each for each in self.held.store.attempts(row.id) if each.first_iteration >= row.iteration]
        return sum(each.id == live.attempt or each.state in {AttemptState.LOST, AttemptState.FAILED} for each in since)

    def _ended(self, drive: Drive, live: Live, row: TrialRow) -> None:
        self.held.forget(drive, live)
        drive.end_of(row)
        self.sweep(drive, row.number)

    def sweep(self, drive: Drive, trial: int) -> None:
        """A trial has ended for good, and that is on record: nothing goes on from its checkpoints."""
        if not drive.spec.keep_checkpoints:
            self.drop_checkpoints(drive.key, trial)

    def queued_again(self, drive: Drive, live: Live, row: TrialRow, *, wait: float) -> None:
        self.held.forget(drive, live)
        drive.open[row.number] = row
        drive.not_before[row.number] = self.clock() + wait


def live_hindrance(found: tuple[Drive, Live]) -> str:
    """What an attempt is known to wait for; empty where it doesn't."""
    drive, live = found
    return drive.hindered.get(live.attempt, "")


def why_stopping(drive: Drive, live: Live) -> str:
    """The reason for an attempt of a study to be interrupted."""
    return drive.leaving.reason if drive.leaving else live.why or "asked to stop"


def _backoff(drive: Drive, retries: int) -> float:
    """Seconds to wait before a retry: doubling, at most a minute."""
    return min(60.0, drive.spec.retries.backoff_seconds * 2.0 ** min(10, max(0, retries - 1)))


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
