"""States and ids, named once. States say what happened."""

from __future__ import annotations

from enum import StrEnum


class StudyState(StrEnum):
    """Where a study stands."""

    QUEUED = "queued"
    """Submitted; nobody drives it yet."""
    RUNNING = "running"
    PAUSED = "paused"
    """By request, or because the record could not be written; `reason` says which."""
    COMPLETE = "complete"
    """Its budget is spent; it can be extended."""
    CANCELLED = "cancelled"
    FAILED = "failed"
    """Stopped by the service, with a reason (every trial failed, the task vanished)."""


class TrialState(StrEnum):
    """Where a trial stands. All but `queued` and `running` are final."""

    QUEUED = "queued"
    RUNNING = "running"
    COMPLETE = "complete"
    INFEASIBLE = "infeasible"
    DIVERGED = "diverged"
    FAILED = "failed"
    CANCELLED = "cancelled"


class AttemptState(StrEnum):
    """How one attempt at a trial went: the states of its trial, and two ways of not ending."""

    RUNNING = "running"
    COMPLETE = "complete"
    INFEASIBLE = "infeasible"
    DIVERGED = "diverged"
    FAILED = "failed"
    CANCELLED = "cancelled"
    LOST = "lost"
    """The worker vanished; the trial is retried from its checkpoint."""
    PREEMPTED = "preempted"
    """Stopped at a checkpoint by shutdown, pause or priority; the trial is continued."""


LIVE_STUDY = frozenset({StudyState.QUEUED, StudyState.RUNNING, StudyState.PAUSED})
OPEN_TRIAL = frozenset({TrialState.QUEUED, TrialState.RUNNING})
OBSERVED_TRIAL = frozenset({TrialState.COMPLETE, TrialState.INFEASIBLE, TrialState.DIVERGED, TrialState.FAILED})
"""Finished trials that are observations for the search; a cancelled one tells nothing."""
