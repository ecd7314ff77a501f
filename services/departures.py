"""Studies on their way out of a driver's hands: because people ask, because they are done, because another took over.

A study that leaves is asked to stop at its next checkpoints, and released when nothing of it runs any more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from services.arrivals import Arrivals, why_stopping
from services.dispatch.port import Dispatcher
from services.drive import Drive, Leaving, Live
from services.errors import DatabaseUnavailable, Refused
from services.held import Effect, Held, Write
from services.proposing import Strategist
from services.states import StudyState
from services.store.port import Change, Store

CONTROL_SECONDS = 0.5
"""How often the driver looks for what people asked for."""

GRACE_SECONDS = 20.0
"""How long attempts have to reach their next checkpoint when they are asked to stop."""


@dataclass(slots=True)
class Departures:
    """Lets studies go.

    Args:
        store: the trial database.
        held: the driven studies.
        dispatcher: runs their attempts.
        strategist: computes their proposals.
        arrivals: what has arrived from workers.
        clock: monotonic seconds.
        leave: how all studies are left, once the driver has been asked to leave itself.
    """

    store: Store
    held: Held
    dispatcher: Dispatcher
    strategist: Strategist
    arrivals: Arrivals
    clock: Callable[[], float]
    leave: Leaving | None = None
    _control_due: float = 0.0

    def guarded(self, drive: Drive, write: Write) -> None:
        """Commit for a study; drop it where another driver has taken it over."""
        try:
            self.held.commit(write)
        except Refused as refusal:
            self._drop(drive, str(refusal))

    def control(self) -> None:
        """Follow what people asked for. Also called while an inline trial runs, hence cheap when not due."""
        if self.leave is not None:
            for drive in self.held.drives.values():
                if drive.leaving is None:
                    self.send_away(drive, self.leave)
        now = self.clock()
        if now < self._control_due:
            return
        self._control_due = now + CONTROL_SECONDS
        try:
            rows = self.store.wanted(list(self.held.drives))
        except DatabaseUnavailable:
            return
        for drive in list(self.held.drives.values()):
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
                self.send_away(drive, Leaving(StudyState.PAUSED, "paused by request", asked=True))
            elif row.wanted == "cancel" and not (drive.leaving and drive.leaving.cancels):
                self.send_away(drive, Leaving(StudyState.CANCELLED, "cancelled by request", cancels=True))

    def send_away(self, drive: Drive, leaving: Leaving) -> None:
        """Ask everything of a study to stop, and release it then."""
        drive.leaving = leaving
        drive.leave_by = self.clock() + GRACE_SECONDS
        drive.asked = None
        for live in drive.live.values():
            if not live.stopping:
                live.stopping = True
                self.dispatcher.stop(live.attempt)

    def _drop(self, drive: Drive, reason: str | None = None) -> None:
        """The study is another driver's now, or deleted: end our workers, write nothing for it but what happened."""
        for live in list(drive.live.values()):
            self.dispatcher.kill(live.attempt)
            self.held.forget(drive, live)
        self.held.release(drive)
        self.strategist.close(drive.row.id)
        if reason is not None:
            self.held.note(drive.row.id, "driver_fenced", reason)

    def stopped_by_force(self, drive: Drive, live: Live) -> None:
        """It had its time to reach a checkpoint; its last one is what the next attempt goes on from."""
        self.dispatcher.kill(live.attempt)

        def write(change: Change) -> list[Effect]:
            why = f"{why_stopping(drive, live)} (ended after {GRACE_SECONDS:g} s)"
            row = change.preempt(live.attempt, live.token, why)
            return [lambda: self.arrivals.queued_again(drive, live, row, wait=0.0)]

        self.guarded(drive, write)

    def release(self) -> None:
        """Let those go that are done, or leave and have stopped."""
        for drive in list(self.held.drives.values()):
            if drive.leaving is None:
                reason = drive.hopeless()
                if reason is not None:
                    self.send_away(drive, Leaving(StudyState.FAILED, reason))
                elif drive.finished():
                    drive.leaving = Leaving(StudyState.COMPLETE, "")
            if drive.leaving is not None and not drive.live:
                self._let_go(drive, drive.leaving)

    def _let_go(self, drive: Drive, leaving: Leaving) -> None:
        # A last look: whoever extended the study, or took a pause back, was told that its driver goes on.
        row = self.store.wanted([drive.row.id]).get(drive.row.id)
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

        self.guarded(drive, write)

    def _released(self, drive: Drive, cancelled: Sequence[int]) -> None:
        for number in cancelled:
            self.arrivals.sweep(drive, number)
        self.held.release(drive)
        self.strategist.close(drive.row.id)
