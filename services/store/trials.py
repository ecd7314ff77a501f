"""The transitions of trials and their attempts: proposed, started, reported, ended.

Their guards are in the statements (`trial_statements`); here is what a transition is made of, and what a refusal says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select

from services.errors import Refused
from services.states import OBSERVED_TRIAL, AttemptState, TrialState
from services.store import trial_statements as statements
from services.store.journal import Journal
from services.store.port import JSON, AttemptRow, NewTrial, Result, TrialRow
from services.store.rows import amount, attempt_row, clean, encode, finite, seed_text, trial_row
from services.store.schema import attempts, studies, trials


class TrialTransitions(Journal):
    """What can happen to a trial."""

    def propose(
        self,
        study_id: int,
        drive_token: int,
        *,
        strategy: str,
        history: int,
        pending: Sequence[int],
        rng_key: Sequence[int],
        seconds: float,
        trials: Sequence[NewTrial],
        info: Mapping[str, JSON] | None = None,
    ) -> list[TrialRow]:
        """Record a proposal and its trials (`queued`), numbered in order. Raises `Refused`."""
        proposal = {
            "study_id": study_id,
            "strategy": strategy,
            "history": history,
            "pending": encode("proposal.pending", [int(number) for number in pending]),
            "rng_key": encode("proposal.rng_key", [int(word) for word in rng_key]),
            "count": len(trials),
            "seconds": amount("proposal.seconds", seconds),
            "info": encode("proposal.info", dict(info or {})),
            "created_at": self._at,
        }
        rows: list[dict[str, Any]] = [
            {
                "study_id": study_id,
                "stage": trial.stage,
                "state": TrialState.QUEUED.value,
                "params": encode("trial.params", dict(trial.params)),
                "z": finite("trial.z", trial.z),
                "warm_start": trial.warm_start,
                "seed": seed_text(trial.seed),
                "info": encode("trial.info", dict(trial.info)),
                "created_at": self._at,
            }
            for trial in trials
        ]
        counted = self._execute(
            statements.NUMBER_TRIALS, {"study": study_id, "held_token": drive_token, "more": len(rows)}
        ).scalar_one_or_none()
        if counted is None:
            raise self._refuse_driver(study_id, drive_token, "the proposal")
        proposal_id = self._execute(statements.ADD_PROPOSAL, proposal).scalar_one()
        for number, row in enumerate(rows, start=counted - len(rows)):
            row |= {"number": number, "proposal_id": proposal_id}
        added = [trial_row(row) for row in self._execute(statements.ADD_TRIALS, rows)] if rows else []
        self._append(
            "proposed",
            study_id,
            None,
            {"proposal": proposal_id, "strategy": strategy, "trials": [trial.number for trial in added]},
        )
        return added

    def start(
        self, trial_id: int, drive_token: int, *, worker: str, host: str = "", pid: int | None = None
    ) -> AttemptRow:
        """`queued` -> `running` with a new attempt. Raises `Refused`."""
        trial = self._execute(
            statements.START, {"trial": trial_id, "held_token": drive_token, "at": self._at}
        ).one_or_none()
        if trial is None:
            raise self._refuse_trial(trial_id, drive_token, "the start", "queued")
        attempt = {
            "trial_id": trial_id,
            "number": trial.attempts,
            "state": AttemptState.RUNNING.value,
            # Attempts are numbered without holes, so their number is a token that rises.
            "token": trial.attempts,
            "worker": clean(worker),
            "host": clean(host),
            "pid": pid,
            "first_iteration": trial.iteration,
            "started_at": self._at,
            "beat_at": self._at,
        }
        row = attempt_row(self._execute(statements.ADD_ATTEMPT, attempt).one())
        self._append("started", trial.study_id, trial.number, {"attempt": row.number, "worker": worker, "host": host})
        return row

    def began(self, attempt_id: int, token: int, *, host: str, pid: int) -> None:
        """A worker process has taken the attempt up. Raises the beat. Raises `Refused`."""
        values = {"attempt": attempt_id, "held_token": token, "at": self._at, "host": clean(host), "pid": pid}
        held = self._execute(statements.BEGAN, values).one_or_none()
        if held is None:
            raise self._refuse_attempt(attempt_id, token, "the start")
        trial = self._execute(statements.PLACE, {"trial": held.trial_id}).one()
        self._append("began", trial.study_id, trial.number, {"attempt": held.number, "host": host, "pid": pid})

    def beat(self, attempt_id: int, token: int) -> None:
        """Say that the attempt lives. Raises `Refused`."""
        if (
            self._execute(statements.BEAT, {"attempt": attempt_id, "held_token": token, "at": self._at}).one_or_none()
            is None
        ):
            raise self._refuse_attempt(attempt_id, token, "the beat")

    def report(
        self,
        attempt_id: int,
        token: int,
        *,
        iteration: int,
        metrics: Mapping[str, float],
        samples: int,
        seconds: float,
    ) -> None:
        """Metrics of an iteration (from 1), and the trial's cost so far over all attempts. Raises `Refused`."""
        values = {name: float(value) for name, value in metrics.items()}
        text = encode(f"metrics of iteration {iteration}", values)
        cost = {
            "to_iteration": iteration,
            "to_samples": int(amount("samples", samples)),
            "to_seconds": amount("seconds", seconds),
        }
        held = self._execute(
            statements.BEAT, {"attempt": attempt_id, "held_token": token, "at": self._at}
        ).one_or_none()
        if held is None:
            raise self._refuse_attempt(attempt_id, token, f"the report of iteration {iteration}")
        trial_id, attempt = held
        row = {"trial_id": trial_id, "iteration": iteration, "attempt": attempt, "metrics": text}
        self._collect(statements.PUT_METRICS[self._connection.dialect.name], row)
        trial = self._execute(statements.PROGRESS, {"trial": trial_id, **cost}).one()
        payload = {
            "attempt": attempt,
            "iteration": iteration,
            "metrics": values,
            "samples": cost["to_samples"],
            "seconds": cost["to_seconds"],
        }
        self._append("progress", trial.study_id, trial.number, payload)

    def finish(self, attempt_id: int, token: int, result: Result) -> TrialRow:
        """The attempt ended with an outcome: the trial is final and has its `position`. Raises `Refused`."""
        if result.state not in OBSERVED_TRIAL:
            raise ValueError(f"result.state: expected one of {sorted(OBSERVED_TRIAL)}, found {result.state!r}")
        features = None
        if result.features is not None:
            features = encode("result.features", [float(value) for value in result.features])
        values = {
            "to_state": result.state.value,
            "to_value": finite("result.value", result.value),
            "to_features": features,
            "to_samples": int(amount("result.samples", result.samples)),
            "to_seconds": amount("result.seconds", result.seconds),
            "to_message": clean(result.message),
            "to_details": encode("result.details", dict(result.details)),
            "at": self._at,
        }
        trial_id, attempt = self._end(attempt_id, token, AttemptState(result.state.value), result.message, "the result")
        trial = trial_row(self._execute(statements.FINISH, {"trial": trial_id, **values}).one())
        for artifact in result.artifacts:
            row = {
                "trial_id": trial_id,
                "name": artifact.name,
                "path": artifact.path,
                "sha256": artifact.sha256,
                "size": artifact.size,
                "created_at": self._at,
            }
            self._collect(statements.PUT_ARTIFACTS[self._connection.dialect.name], row)
        self._finished(trial, attempt)
        return trial

    def lose(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """The worker vanished: trial `queued` again, one more retry counted. Raises `Refused`."""
        return self._again(attempt_id, token, AttemptState.LOST, reason, retries=1)

    def fail(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """The task's own error: trial `queued` again, one more retry counted. Raises `Refused`."""
        return self._again(attempt_id, token, AttemptState.FAILED, reason, retries=1)

    def preempt(self, attempt_id: int, token: int, reason: str) -> TrialRow:
        """Stopped at a checkpoint: trial `queued` again. Raises `Refused`."""
        return self._again(attempt_id, token, AttemptState.PREEMPTED, reason, retries=0)

    def give_up(self, trial_id: int, drive_token: int, message: str) -> TrialRow:
        """A `queued` trial out of retries becomes `failed`, with its `position`. Raises `Refused`."""
        values = {"trial": trial_id, "held_token": drive_token, "to_message": clean(message), "at": self._at}
        row = self._execute(statements.GIVE_UP, values).one_or_none()
        if row is None:
            raise self._refuse_trial(trial_id, drive_token, "giving up", "queued")
        trial = trial_row(row)
        self._finished(trial, None)
        return trial

    def cancel_trial(self, trial_id: int, drive_token: int, reason: str) -> TrialRow:
        """An open trial becomes `cancelled`, a running attempt with it. Raises `Refused`."""
        why = clean(reason)
        values = {"trial": trial_id, "held_token": drive_token, "to_message": why, "at": self._at}
        row = self._execute(statements.CANCEL, values).one_or_none()
        if row is None:
            raise self._refuse_trial(trial_id, drive_token, "the cancellation", "queued or running")
        self._execute(statements.CANCEL_ATTEMPT, {"trial": trial_id, "at": self._at, "why": why})
        trial = trial_row(row)
        self._finished(trial, None)
        return trial

    def _again(self, attempt_id: int, token: int, state: AttemptState, reason: str, *, retries: int) -> TrialRow:
        trial_id, attempt = self._end(attempt_id, token, state, reason, f"ending it as {state.value}")
        trial = trial_row(self._execute(statements.REQUEUE, {"trial": trial_id, "more": retries}).one())
        payload = {"attempt": attempt, "reason": clean(reason), "retries": trial.retries}
        self._append(state.value, trial.study_id, trial.number, payload)
        return trial

    def _end(self, attempt_id: int, token: int, state: AttemptState, reason: str, what: str) -> tuple[int, int]:
        """End an attempt that still holds its trial; the trial's id and the attempt's number."""
        values = {
            "attempt": attempt_id,
            "held_token": token,
            "to_state": state.value,
            "at": self._at,
            "why": clean(reason),
        }
        held = self._execute(statements.END_ATTEMPT, values).one_or_none()
        if held is None:
            raise self._refuse_attempt(attempt_id, token, what)
        return held.trial_id, held.number

    def _finished(self, trial: TrialRow, attempt: int | None) -> None:
        payload = {
            "state": trial.state.value,
            "position": trial.position,
            "value": trial.value,
            "features": trial.features,
            "samples": trial.samples,
            "seconds": trial.seconds,
            "message": trial.message,
            "attempt": attempt,
        }
        self._append("finished", trial.study_id, trial.number, payload)

    def _refuse_attempt(self, attempt_id: int, token: int, what: str) -> Refused:
        """Why an attempt's token doesn't hold, for raising."""
        row = self._execute(
            select(
                attempts.c.number, attempts.c.state, attempts.c.token, attempts.c.reason, trials.c.number.label("trial")
            )
            .join(trials)
            .where(attempts.c.id == attempt_id)
        ).one_or_none()
        if row is None:
            return Refused(f"{what} of attempt {attempt_id}: expected a running attempt, found none of that id")
        where = f"{what} of attempt {row.number} of trial {row.trial}"
        if row.token != token:
            return Refused(f"{where}: expected its token {row.token}, found {token}; it doesn't hold the trial")
        why = f" ({row.reason})" if row.reason else ""
        return Refused(f"{where}: expected it running, found it {row.state}{why}; it holds the trial no more")

    def _refuse_trial(self, trial_id: int, drive_token: int, what: str, expected: str) -> Refused:
        """Why a driver may not do this to a trial, for raising."""
        row = self._execute(
            select(trials.c.number, trials.c.state, trials.c.study_id, studies.c.driver_id, studies.c.drive_token)
            .join(studies)
            .where(trials.c.id == trial_id)
        ).one_or_none()
        if row is None:
            return Refused(f"{what} of a trial: expected trial id {trial_id}, found none")
        if row.driver_id is None or row.drive_token != drive_token:
            return self._refuse_driver(row.study_id, drive_token, f"{what} of trial {row.number}")
        return Refused(f"{what} of trial {row.number}: expected it {expected}, found it {row.state}")
