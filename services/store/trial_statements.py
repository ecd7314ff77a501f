"""The statements by which trials and their attempts change.

Every guard is in the WHERE of the first statement that writes, so a transition that is refused has written nothing.
An attempt that is not `running` any more has lost its lease, whoever took it: nothing but its state and its token
decides, no clock does.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import bindparam, func, select, update
from sqlalchemy.dialects import postgresql, sqlite

from services.store.rows import ATTEMPT, TRIAL
from services.store.schema import artifacts, attempts, metrics, proposals, studies, trials

DRIVEN = select(studies.c.id).where(
    studies.c.id == trials.c.study_id,
    studies.c.drive_token == bindparam("held_token"),
    studies.c.driver_id.is_not(None),
)
NUMBER_TRIALS = (
    update(studies)
    .where(studies.c.id == bindparam("study"), studies.c.drive_token == bindparam("held_token"))
    .where(studies.c.driver_id.is_not(None))
    .values(trial_count=studies.c.trial_count + bindparam("more"))
    .returning(studies.c.trial_count)
)
ADD_PROPOSAL = proposals.insert().returning(proposals.c.id)
ADD_TRIALS = trials.insert().returning(*TRIAL, sort_by_parameter_order=True)

START = (
    update(trials)
    .where(trials.c.id == bindparam("trial"), trials.c.state == "queued", DRIVEN.exists())
    .values(
        state="running",
        attempts=trials.c.attempts + 1,
        started_at=func.coalesce(trials.c.started_at, bindparam("at")),
    )
    .returning(trials.c.study_id, trials.c.number, trials.c.attempts, trials.c.iteration)
)
ADD_ATTEMPT = attempts.insert().returning(*ATTEMPT)

HELD = (
    attempts.c.id == bindparam("attempt"),
    attempts.c.token == bindparam("held_token"),
    attempts.c.state == "running",
)
BEAT = (
    update(attempts)
    .where(*HELD)
    .values(beat=attempts.c.beat + 1, beat_at=bindparam("at"))
    .returning(attempts.c.trial_id, attempts.c.number)
)
BEGAN = BEAT.values(host=bindparam("host"), pid=bindparam("pid"))
END_ATTEMPT = (
    update(attempts)
    .where(*HELD)
    .values(state=bindparam("to_state"), ended_at=bindparam("at"), reason=bindparam("why"))
    .returning(attempts.c.trial_id, attempts.c.number)
)
PLACE = select(trials.c.study_id, trials.c.number).where(trials.c.id == bindparam("trial"))
PROGRESS = (
    update(trials)
    .where(trials.c.id == bindparam("trial"))
    .values(iteration=bindparam("to_iteration"), samples=bindparam("to_samples"), seconds=bindparam("to_seconds"))
    .returning(trials.c.study_id, trials.c.number)
)

_others = trials.alias("others")
# The next free place in the history. Writers come one after the other, and the history has no holes, so it is one
# more than the highest; the unique index on (study_id, position) finds that at once and would refuse a double.
NEXT_POSITION = (
    select(func.coalesce(func.max(_others.c.position) + 1, 0))
    .where(_others.c.study_id == trials.c.study_id)
    .scalar_subquery()
)
FINISH = (
    update(trials)
    .where(trials.c.id == bindparam("trial"))
    .values(
        state=bindparam("to_state"),
        position=NEXT_POSITION,
        value=bindparam("to_value"),
        features=bindparam("to_features"),
        samples=bindparam("to_samples"),
        seconds=bindparam("to_seconds"),
        message=bindparam("to_message"),
        details=bindparam("to_details"),
        finished_at=bindparam("at"),
    )
    .returning(*TRIAL)
)
GIVE_UP = (
    update(trials)
    .where(trials.c.id == bindparam("trial"), trials.c.state == "queued", DRIVEN.exists())
    .values(state="failed", position=NEXT_POSITION, message=bindparam("to_message"), finished_at=bindparam("at"))
    .returning(*TRIAL)
)
REQUEUE = (
    update(trials)
    .where(trials.c.id == bindparam("trial"))
    .values(state="queued", retries=trials.c.retries + bindparam("more"))
    .returning(*TRIAL)
)
CANCEL = (
    update(trials)
    .where(trials.c.id == bindparam("trial"), trials.c.state.in_(("queued", "running")), DRIVEN.exists())
    .values(state="cancelled", message=bindparam("to_message"), finished_at=bindparam("at"))
    .returning(*TRIAL)
)
CANCEL_ATTEMPT = (
    update(attempts)
    .where(attempts.c.trial_id == bindparam("trial"), attempts.c.state == "running")
    .values(state="cancelled", ended_at=bindparam("at"), reason=bindparam("why"))
)


def _upsert(dialect: Any, table: Any, key: tuple[str, ...], replaced: tuple[str, ...]) -> Any:
    statement = dialect.insert(table)
    return statement.on_conflict_do_update(
        index_elements=list(key), set_={name: statement.excluded[name] for name in replaced}
    )


# The same words in both dialects, but SQLAlchemy has them in two places.
_DIALECTS = {"sqlite": sqlite, "postgresql": postgresql}
PUT_METRICS = {
    name: _upsert(dialect, metrics, ("trial_id", "iteration"), ("attempt", "metrics"))
    for name, dialect in _DIALECTS.items()
}
PUT_ARTIFACTS = {
    name: _upsert(dialect, artifacts, ("trial_id", "name"), ("path", "sha256", "size", "created_at"))
    for name, dialect in _DIALECTS.items()
}
