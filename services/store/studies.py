"""The transitions of studies: made, asked, driven, extended, deleted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from sqlalchemy import bindparam, func, null, select, update

from services.errors import NameTaken, Refused, StudyDriven, WrongState
from services.states import LIVE_STUDY, StudyState
from services.store.journal import Journal
from services.store.port import JSON, Driver, StudyRow
from services.store.reads import one_study
from services.store.rows import amount, clean, encode, seed_text
from services.store.schema import attempts, events, studies, trials

_ENDED = (StudyState.COMPLETE, StudyState.CANCELLED, StudyState.FAILED)

_DRIVEN_BY = (
    (studies.c.id == bindparam("study"))
    & (studies.c.drive_token == bindparam("token"))
    & (studies.c.driver_id.is_not(None))
)
_BEAT_DRIVE = update(studies).where(_DRIVEN_BY).values(drive_beat=studies.c.drive_beat + 1)
_REMARK = update(studies).where(_DRIVEN_BY).values(reason=bindparam("to_reason"))
_RELEASE = (
    update(studies)
    .where(_DRIVEN_BY)
    .values(
        driver_id=null(),
        driver_host=null(),
        driver_pid=null(),
        driver_started=null(),
        driven_since=null(),
        state=bindparam("to_state"),
        reason=bindparam("to_reason"),
        finished_at=bindparam("to_finished_at"),
    )
)
_RUNNING_ATTEMPTS = (
    select(func.count())
    .select_from(attempts.join(trials))
    .where(trials.c.study_id == bindparam("study"), trials.c.state == "running", attempts.c.state == "running")
)
_LOSE_ATTEMPTS = (
    update(attempts)
    .where(
        attempts.c.state == "running",
        attempts.c.trial_id.in_(
            select(trials.c.id).where(trials.c.study_id == bindparam("study"), trials.c.state == "running")
        ),
    )
    .values(state="lost", ended_at=bindparam("at"), reason=bindparam("why"))
    .returning(attempts.c.trial_id, attempts.c.number)
)
_REQUEUE_TRIALS = (
    update(trials)
    .where(trials.c.study_id == bindparam("study"), trials.c.state == "running")
    .values(state="queued")
    .returning(trials.c.id, trials.c.number, trials.c.retries)
)
_CANCEL_QUEUED = (
    update(trials)
    .where(trials.c.study_id == bindparam("study"), trials.c.state == "queued")
    .values(state="cancelled", message=bindparam("why"), finished_at=bindparam("at"))
    .returning(trials.c.number)
)


class StudyTransitions(Journal):
    """What can happen to a study."""

    def create_study(
        self,
        name: str,
        spec: Mapping[str, JSON],
        *,
        seed: int,
        pool: str = "default",
        priority: int = 0,
        target_trials: int | None = None,
        target_cost: float | None = None,
    ) -> StudyRow:
        """A new study, `queued`. Raises `NameTaken`."""
        values = {
            "name": name,
            "state": StudyState.QUEUED.value,
            "spec": encode("study.spec", spec),
            "seed": seed_text(seed),
            "pool": pool,
            "priority": priority,
            "target_trials": target_trials,
            "target_cost": target_cost,
            "created_at": self._at,
        }
        taken = self._execute(select(studies.c.state).where(studies.c.name == name)).scalar_one_or_none()
        if taken is not None:
            raise NameTaken(
                f"study {name!r}: expected a name that is free, found a study of that name, {taken}; "
                "resume or extend that one, or give another name"
            )
        row = self._execute(studies.insert().returning(studies.c.id), values).one()
        self._append("created", row.id, None, {"study": name, "target_trials": target_trials})
        return self._read(name)

    def delete_study(self, name: str) -> None:
        """Forget a study that is not live, with all its rows but the event that says so."""
        row = self._study_named(name)
        if StudyState(row.state) in LIVE_STUDY:
            raise WrongState(
                f"study {name!r}: expected one that has ended, found it {row.state}; cancel it before deleting it"
            )
        self.flush()
        self._execute(events.delete().where(events.c.study_id == row.id))
        self._execute(studies.delete().where(studies.c.id == row.id))
        self._append("deleted", row.id, None, {"study": name})

    def ask(self, name: str, wanted: str) -> StudyRow:
        """Ask for `run`, `pause` or `cancel`; see the port."""
        if wanted not in {"run", "pause", "cancel"}:
            raise ValueError(f"wanted: expected 'run', 'pause' or 'cancel', found {wanted!r}")
        row = self._study_named(name)
        state = StudyState(row.state)
        values: dict[str, Any] = {"wanted": wanted}
        if row.driver_id is None:
            values |= self._asked_undriven(row, state, wanted)
        self._execute(update(studies).where(studies.c.id == row.id), values)
        self._append("asked", row.id, None, {"wanted": wanted, "state": values.get("state", row.state)})
        return self._read(name)

    def _asked_undriven(self, row: Any, state: StudyState, wanted: str) -> dict[str, Any]:
        """What changes at once where nobody drives. Raises `WrongState`."""
        if wanted == "run":
            if state is StudyState.COMPLETE:
                raise WrongState(
                    f"study {row.name!r}: expected one with budget left, found it complete; extend it to go on"
                )
            return {"state": StudyState.QUEUED.value, "reason": "", "finished_at": None}
        to = StudyState.PAUSED if wanted == "pause" else StudyState.CANCELLED
        if state is to:
            return {}
        if state in _ENDED:
            raise WrongState(f"study {row.name!r}: expected a live one to {wanted}, found it {row.state}")
        if to is StudyState.PAUSED:
            return {"state": to.value, "reason": "asked to pause"}
        self._cancel_queued(row.id, "the study was cancelled")
        return {"state": to.value, "reason": "asked to cancel", "finished_at": self._at}

    def extend(self, name: str, *, trials: int = 0, cost: float = 0.0, rounds: int = 0) -> StudyRow:
        """Raise the targets; see the port."""
        row = self._study_named(name)
        amount("cost", cost)
        if min(trials, rounds) < 0 or not (trials or cost or rounds):
            raise WrongState(
                f"study {name!r}: expected more trials, cost or rounds to extend it by, found {trials} trials, cost "
                f"{cost:g} and {rounds} rounds"
            )
        values: dict[str, Any] = {"spec": _with_rounds(row, rounds)} if rounds else {}
        for target, more in (("target_trials", trials), ("target_cost", cost)):
            if more and getattr(row, target) is None:
                raise WrongState(
                    f"study {name!r}: expected a budget in {target.removeprefix('target_')} to extend, found none; "
                    "extend the budget it has"
                )
            if more:
                values[target] = getattr(row, target) + more
        if row.state == StudyState.COMPLETE:
            values |= {"state": StudyState.QUEUED.value, "wanted": "run", "reason": "", "finished_at": None}
        self._execute(update(studies).where(studies.c.id == row.id), values)
        told = {"trials": trials, "cost": cost, "rounds": rounds, "state": values.get("state", row.state)}
        self._append("extended", row.id, None, told)
        return self._read(name)

    def amend(self, name: str, fields: Mapping[str, JSON]) -> StudyRow:
        """Change fields of a study's spec; see the port."""
        row = self._study_named(name)
        spec = json.loads(row.spec)
        changes: dict[str, JSON] = {}
        for field, value in fields.items():
            *outer, last = field.split(".")
            inner = spec
            for part in outer:
                inner = inner.setdefault(part, {})
            if last not in inner or inner[last] != value:
                changes[field] = {"from": inner.get(last), "to": value}
                inner[last] = value
        if changes:
            columns = {"priority": "priority", "resources.pool": "pool"}
            values = {columns[field]: fields[field] for field in changes if field in columns}
            values["spec"] = encode("study.spec", spec)
            self._execute(update(studies).where(studies.c.id == row.id), values)
            self._append("amended", row.id, None, {"changes": changes})
        return self._read(name)

    def drive(self, name: str, driver: Driver, *, take_over_from: int | None = None) -> int:
        """Become the driver; the study becomes `running`. Returns the new drive token; see the port."""
        row = self._study_named(name)
        if row.driver_id is None:
            resumable = row.state == StudyState.QUEUED or (row.state == StudyState.PAUSED and row.wanted == "run")
            if not resumable:
                raise WrongState(
                    f"study {name!r}: expected one that is queued, found it {row.state}; "
                    + ("extend it" if row.state == StudyState.COMPLETE else "resume it")
                )
        elif take_over_from != row.drive_token:
            raise StudyDriven(
                f"study {name!r}: expected that nobody drives it, found {row.driver_id} (process {row.driver_pid} on "
                f"{row.driver_host}) driving it since {row.driven_since[:19]} UTC; stop that one, or take over from it"
            )
        token = int(row.drive_token) + 1
        taken_over = row.driver_id is not None
        self._execute(
            update(studies).where(studies.c.id == row.id, studies.c.drive_token == row.drive_token),
            {
                "state": StudyState.RUNNING.value,
                "reason": "",
                "driver_id": clean(driver.id),
                "driver_host": clean(driver.host),
                "driver_pid": driver.pid,
                "driver_started": clean(driver.started),
                "driven_since": self._at,
                "drive_token": token,
                "drive_beat": 0,
                "finished_at": None,
            },
        )
        self._append(
            "driven", row.id, None, {"driver": driver.id, "host": driver.host, "pid": driver.pid, "token": token}
        )
        if taken_over:
            self._requeue_all(row.id, f"the driver {row.driver_id} was taken over by {driver.id}")
        return token

    def _requeue_all(self, study_id: int, why: str) -> None:
        """End the running attempts as `lost`; it is the driver that failed, so no trial's retry is counted."""
        why = clean(why)
        lost = self._execute(_LOSE_ATTEMPTS, {"study": study_id, "at": self._at, "why": why})
        attempt_of = dict(lost.all())
        for trial in self._execute(_REQUEUE_TRIALS, {"study": study_id}).all():
            payload = {"attempt": attempt_of.get(trial.id), "reason": why, "retries": trial.retries}
            self._append("lost", study_id, trial.number, payload)

    def beat_drive(self, study_id: int, drive_token: int) -> None:
        """Say that the driver lives. Raises `Refused`."""
        if self._execute(_BEAT_DRIVE, {"study": study_id, "token": drive_token}).rowcount != 1:
            raise self._refuse_driver(study_id, drive_token, "the driver's beat")

    def remark(self, study_id: int, drive_token: int, reason: str) -> None:
        """Say why a driven study waits, or that it goes on. Raises `Refused`."""
        values = {"study": study_id, "token": drive_token, "to_reason": clean(reason)}
        if self._execute(_REMARK, values).rowcount != 1:
            raise self._refuse_driver(study_id, drive_token, "the remark")
        self._append("waiting" if reason else "going_on", study_id, None, {"reason": clean(reason)})

    def release_drive(self, study_id: int, drive_token: int, state: StudyState, reason: str = "") -> None:
        """Stop driving and leave the study in `state`. Raises `Refused`; no attempt may be running.

        A study that is left `cancelled` has no open trials: those still queued are cancelled with it.
        """
        if state is StudyState.RUNNING:
            raise ValueError("state: expected the state to leave the study in, found 'running', which needs a driver")
        running = self._execute(_RUNNING_ATTEMPTS, {"study": study_id}).scalar_one()
        if running:
            raise Refused(
                f"the release of study {study_id}: expected no running attempt, found {running}; "
                "preempt, finish or cancel them before letting go"
            )
        values = {
            "study": study_id,
            "token": drive_token,
            "to_state": state.value,
            "to_reason": clean(reason),
            "to_finished_at": self._at if state in _ENDED else None,
        }
        if self._execute(_RELEASE, values).rowcount != 1:
            raise self._refuse_driver(study_id, drive_token, "the release")
        if state is StudyState.CANCELLED:
            self._cancel_queued(study_id, "the study was cancelled")
        self._append("released", study_id, None, {"state": state.value, "reason": clean(reason)})

    def _cancel_queued(self, study_id: int, why: str) -> None:
        for (number,) in self._execute(_CANCEL_QUEUED, {"study": study_id, "why": why, "at": self._at}).all():
            self._append("finished", study_id, number, {"state": "cancelled", "position": None, "message": why})

    def _read(self, name: str) -> StudyRow:
        study = one_study(self._connection, name)
        if study is None:  # pragma: no cover - it was there a statement ago, in this very transaction
            raise RuntimeError(f"study {name!r} vanished within its transaction")
        return study


def _with_rounds(row: Any, rounds: int) -> str:
    """A study's spec with so many more rounds in every stage that has some. Raises `WrongState`."""
    if row.driver_id is not None:
        raise WrongState(
            f"study {row.name!r}: expected one that nobody drives to give more rounds, found it {row.state}; "
            f"pause it first: halma pause {row.name}"
        )
    spec = json.loads(row.spec)
    stages = [stage for stage in (spec.get("stages") or {}).values() if "rounds" in stage]
    if not stages:
        raise WrongState(
            f"study {row.name!r}: expected a stage of kind polish to give more rounds, found none; extend its trials"
        )
    for stage in stages:
        stage["rounds"] += rounds
    return encode("study.spec", spec)
