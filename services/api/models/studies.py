"""Studies: what they were asked, how they stand, what was proposed and found."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import Field, JsonValue

from services.amending import AMENDABLE
from services.api.models.basis import Cost, Model, Page, Position
from services.budget import most_trials
from services.states import StudyState
from services.store.port import ProposalRow, StudyRow


class DriverOut(Model):
    """The process that drives a study."""

    host: str
    pid: int
    since: datetime | None


class StudySummary(Model):
    """A study as a listing shows it."""

    name: str
    state: StudyState
    reason: str = Field(description="why it is paused or failed, for people")
    wanted: str = Field(description="what people asked for: run, pause or cancel")
    task: str
    strategy: str
    pool: str
    priority: int
    seed: int
    target_trials: int | None = Field(description="at most so many trials, those of later stages among them")
    search_trials: int | None = Field(description="at most so many trials of the search itself")
    target_cost: float | None
    trials: dict[str, int] = Field(description="number of trials in each state")
    cost: Cost
    best_value: float | None
    driver: DriverOut | None
    created_at: datetime
    finished_at: datetime | None

    @classmethod
    def of(cls, row: StudyRow) -> Self:
        """From the store's row."""
        driver = row.driver
        return cls(
            name=row.name,
            state=row.state,
            reason=row.reason,
            wanted=row.wanted,
            task=task_name(row.spec),
            strategy=strategy_name(row.spec),
            pool=row.pool,
            priority=row.priority,
            seed=row.seed,
            target_trials=most_trials(row),
            search_trials=row.target_trials,
            target_cost=row.target_cost,
            trials=dict(row.counts),
            cost=Cost(samples=row.samples, seconds=row.seconds),
            best_value=row.best_value,
            driver=None if driver is None else DriverOut(host=driver.host, pid=driver.pid, since=row.driven_since),
            created_at=row.created_at,
            finished_at=row.finished_at,
        )


def task_name(spec: Mapping[str, Any]) -> str:
    """The task that a spec names, in its long or its short form."""
    task = spec.get("task", "")
    return str(task.get("name", "")) if isinstance(task, Mapping) else str(task)


def strategy_name(spec: Mapping[str, Any]) -> str:
    """The strategy that a spec names."""
    search = spec.get("search", {})
    return str(search.get("strategy", "")) if isinstance(search, Mapping) else ""


class StudyOut(StudySummary):
    """A study with what was asked for."""

    spec: dict[str, JsonValue]

    @classmethod
    def of(cls, row: StudyRow) -> Self:
        """From the store's row."""
        summary = StudySummary.of(row)
        return cls(**dict(summary), spec=dict(row.spec))


class StudyList(Position, Page):
    """Studies, newest first."""

    studies: list[StudySummary]


class ProposalOut(Model):
    """What one proposal saw and gave."""

    id: int
    strategy: str
    history: int
    pending: list[int]
    rng_key: list[str] = Field(description="entropy of its generator, in decimal")
    count: int
    seconds: float
    info: dict[str, JsonValue]
    created_at: datetime

    @classmethod
    def of(cls, row: ProposalRow) -> Self:
        """From the store's row."""
        return cls(
            id=row.id,
            strategy=row.strategy,
            history=row.history,
            pending=list(row.pending),
            rng_key=[str(word) for word in row.rng_key],
            count=row.count,
            seconds=row.seconds,
            info=dict(row.info),
            created_at=row.created_at,
        )


class ProposalPage(Page):
    """Some proposals, oldest first."""

    proposals: list[ProposalOut]


class StrategyOut(Model):
    """One distinct way of doing it: the best of the trials whose behaviour counts as the same."""

    number: int = Field(description="the trial that stands for it")
    value: float | None
    features: list[float]
    members: int = Field(description="how many trials count as the same, this one among them")
    details: dict[str, JsonValue]
    pose: bool = Field(description="whether the trial left a picture of its pose (`pose.png`)")
    replay: bool = Field(description="whether the trial left its motion (`replay.bin`)")


class StrategyList(Position, Page):
    """The distinct strategies of a study, best first."""

    distance: float | None = Field(description="two behaviours further apart than this are different strategies")
    strategies: list[StrategyOut]


class Submission(Model):
    """A study file to be run."""

    text: Annotated[str, Field(max_length=256 * 1024, description="the study file, YAML")]
    overrides: Annotated[list[str], Field(max_length=64)] = Field(
        default=[], description="`field.field=value`, as with --set"
    )
    name: Annotated[str, Field(max_length=200)] = Field(default="study.yaml", description="what errors call the file")


class Extension(Model):
    """More budget for a study."""

    trials: Annotated[int, Field(ge=0, le=10**9)] = 0
    cost: Annotated[float, Field(ge=0, allow_inf_nan=False, le=1e18)] = Field(
        default=0.0, description="simulation samples"
    )
    rounds: Annotated[int, Field(ge=0, le=1000, description="of each stage of kind polish")] = 0


class Amendment(Model):
    """How a study is to be run from now on."""

    fields: Annotated[dict[str, JsonValue], Field(min_length=1, max_length=len(AMENDABLE))] = Field(
        description=f"values by dotted name: {', '.join(AMENDABLE)}",
        examples=[{"priority": 5, "resources.pool": "gpu"}],
    )
