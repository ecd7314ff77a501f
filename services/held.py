"""The studies in a driver's hands, kept in step with their record: commits, doubts about commits, late messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from services.dispatch.port import Message
from services.drive import Drive, Live
from services.errors import DatabaseUnavailable
from services.states import OPEN_TRIAL, TrialState
from services.store.port import Change, Store

Effect = Callable[[], None]
"""What happens in memory once a commit is safe."""

Tell = Callable[[str], None]
"""Is told a line that people should read now."""

Write = Callable[[Change], list[Effect]]


@dataclass(slots=True)
class Held:
    """Driven studies, by row id, and the attempts under way in them.

    Args:
        store: the trial database.
        sleep: waits some seconds.
        impatient: whether a database that is away shall not be waited for.
        tell: is told when a wait for the database begins, and when it is over.
    """

    store: Store
    sleep: Callable[[float], None]
    impatient: Callable[[], bool]
    tell: Tell
    drives: dict[int, Drive] = field(default_factory=dict)
    study_of: dict[int, int] = field(default_factory=dict)
    """Study of each attempt that this driver has started, by attempt id."""
    trouble: str = ""
    """Why nothing can be recorded now; empty where it can."""

    def live(self, message: Message) -> tuple[Drive, Live] | None:
        """The study and attempt that a message is about; None for one that is not, or no longer, ours."""
        drive = self.drives.get(self.study_of.get(message.attempt, -1))
        live = None if drive is None else drive.live.get(message.attempt)
        return None if drive is None or live is None or live.token != message.token else (drive, live)

    def forget(self, drive: Drive, live: Live) -> None:
        """An attempt is over. Its study stays known, for the late messages of a worker that was given up."""
        drive.live.pop(live.attempt, None)
        drive.hindered.pop(live.attempt, None)

    def release(self, drive: Drive) -> None:
        """A study is out of this driver's hands."""
        self.drives.pop(drive.row.id, None)

    def note(self, study_id: int, kind: str, reason: str) -> None:
        """Append an event about a study."""

        def write(change: Change) -> list[Effect]:
            change.note(kind, study_id=study_id, reason=reason)
            return []

        self.commit(write)

    def commit(self, write: Write, *, again: bool = False) -> None:
        """Commit, then let the effects happen.

        A database that goes away leaves open whether the commit was made. It is waited for (workers go on meanwhile),
        and what is in memory is read anew. Then the write is made `again` where its transitions are safe to repeat
        (a message that was committed is refused the second time); otherwise the next pass decides anew.

        Raises:
            DatabaseUnavailable: it is away, and the driver has been asked to leave.
        """
        while True:
            try:
                with self.store.transaction() as change:
                    effects = write(change)
            except DatabaseUnavailable as error:
                self.wait(error)
                if not again:
                    return
            else:
                break
        for effect in effects:
            effect()

    def wait(self, trouble: DatabaseUnavailable) -> None:
        """Wait until the database can be read and written again, and read the driven studies anew.

        Raises:
            DatabaseUnavailable: it is away, and the driver has been asked to leave.
        """
        pause, reason = 0.1, str(trouble)
        self.trouble = reason
        self.tell(waiting_words(reason))
        while True:
            if self.impatient():
                raise trouble
            self.sleep(pause)
            pause = min(2 * pause, 5.0)
            try:
                # A full or read-only disk can be read: that it can be written is known once something is.
                with self.store.transaction() as change:
                    change.note("database_back", reason=reason)
                for drive in list(self.drives.values()):
                    self._read_anew(drive)
            except DatabaseUnavailable as error:
                trouble = error
            else:
                self.trouble = ""
                self.tell(waiting_words(""))
                return

    def _read_anew(self, drive: Drive) -> None:
        """Make the view of a study agree with its record."""
        row = self.store.study(drive.row.name)
        if row.id != drive.row.id or row.drive_token != drive.token:
            return  # the next look at what people want finds out, and drops it
        # What it was said to wait for may have been undone with the commit that said it.
        drive.follow(row)
        drive.asked, drive.remarked = None, row.reason
        drive.history = self.store.history(row.id)
        drive.open = {trial.number: trial for trial in self.store.trials(row.id, states=OPEN_TRIAL)}
        drive.next_number = sum(row.counts.values())
        for live in list(drive.live.values()):
            if live.trial not in drive.open:
                self.forget(drive, live)
        held = {live.attempt for live in drive.live.values()}
        with self.store.transaction() as change:
            for trial in drive.open.values():
                if trial.state is TrialState.RUNNING:
                    newest = self.store.attempts(trial.id)[-1]
                    if newest.id not in held:
                        # Its start was committed, but the worker was never told.
                        drive.open[trial.number] = change.preempt(newest.id, newest.token, "never dispatched")


def waiting_words(trouble: str) -> str:
    """What people are told when nothing can be recorded, and (no trouble) when it can again."""
    if not trouble:
        return "The database can be written again: going on."
    return f"Nothing can be recorded, so nothing new is started until it can; running trainings go on. {trouble}"
