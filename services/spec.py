"""What a study is asked to do: the frozen `StudySpec`, and the rules that hold for it wherever it comes from.

The models check what can be known without looking at a task or a strategy (`services.spec_check` does that part);
`services.spec_file` reads them from YAML and says where in the file something is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    JsonValue,
    StrictBool,
    StrictStr,
    field_validator,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError

from search.record import SEARCH
from search.stages import in_order
from services.problems import nearest
from services.profiles import PROFILES, relaxed

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
"""Names of studies and pools: they become folder names and parts of URLs."""

LARGEST_SEED = 2**63 - 1
"""Databases keep signed 64-bit integers."""

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Name = Annotated[StrictStr, Field(pattern=NAME_PATTERN, max_length=80)]
Strings = Annotated[tuple[str, ...], Field(strict=False)]
Numbers = Annotated[tuple[float, ...], Field(strict=False)]
Points = Annotated[tuple[dict[str, JsonValue], ...], Field(strict=False)]


def wrong(field: str, message: str) -> PydanticCustomError:
    """An error of a whole section that belongs to one of its fields.

    Args:
        field: the field within the section at which a person should look.
        message: what was expected and what was found.
    """
    return PydanticCustomError("section", "{message}", {"field": field, "message": message})


class Section(BaseModel):
    """A part of a study file: frozen, and without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class FloatParameter(Section):
    """A real parameter between two bounds, both included."""

    type: Literal["float"]
    low: Finite = Field(description="the smallest value")
    high: Finite = Field(description="the largest value")
    log: StrictBool = Field(default=False, description="search on a logarithmic scale; low must be above 0")

    @model_validator(mode="after")
    def _bounds(self) -> Self:
        check_bounds(self.low, self.high, log=self.log)
        return self


class IntParameter(Section):
    """A whole-number parameter between two bounds, both included."""

    type: Literal["int"]
    low: Whole = Field(description="the smallest value")
    high: Whole = Field(description="the largest value")
    log: StrictBool = Field(default=False, description="search on a logarithmic scale; low must be above 0")

    @model_validator(mode="after")
    def _bounds(self) -> Self:
        check_bounds(self.low, self.high, log=self.log)
        return self


class CategoricalParameter(Section):
    """A choice among names."""

    type: Literal["categorical"]
    choices: Annotated[tuple[StrictStr, ...], Field(strict=False, min_length=1, description="the names to choose from")]

    @field_validator("choices")
    @classmethod
    def _distinct(cls, choices: tuple[str, ...]) -> tuple[str, ...]:
        twice = sorted({choice for choice in choices if choices.count(choice) > 1})
        if twice:
            raise PydanticCustomError(
                "choices", "expected different choices, found '{twice}' more than once", {"twice": twice[0]}
            )
        return choices


class AngleParameter(Section):
    """A full circle, in radians from -pi to pi."""

    type: Literal["angle"]


def check_bounds(low: float, high: float, *, log: bool) -> None:
    """Refuse bounds that enclose nothing, and a logarithmic scale that reaches zero (`wrong`)."""
    if low >= high:
        raise wrong("low", f"expected low below high, found low {as_written(low)} and high {as_written(high)}")
    if log and low <= 0:
        raise wrong("low", f"expected low above 0 on a logarithmic scale (log: true), found {as_written(low)}")


def as_written(number: float) -> str:
    """A number as a person would write it: 3 instead of 3.0, and nothing rounded away."""
    return f"{number:g}" if float(f"{number:g}") == number else repr(number)


def _spelled_out(value: Any) -> Any:
    """`angle` is short for `{type: angle}`: it has nothing else to say."""
    return {"type": value} if value == "angle" else value


Parameter = Annotated[
    FloatParameter | IntParameter | CategoricalParameter | AngleParameter,
    Field(discriminator="type"),
]
"""One dimension of the space."""

SpelledParameter = Annotated[
    Parameter, BeforeValidator(_spelled_out, json_schema_input_type=Parameter | Literal["angle"])
]


class TaskChoice(Section):
    """The skill to be learnt. In a file, a bare name is short for `{name: ...}`."""

    name: StrictStr = Field(min_length=1, description="a built-in task, `gymnasium:ID`, or `module:attribute`")
    settings: dict[str, JsonValue] = Field(default_factory=dict, description="settings of the task (`halma tasks`)")

    @model_validator(mode="before")
    @classmethod
    def _bare_name(cls, value: Any) -> Any:
        return {"name": value} if isinstance(value, str) else value

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Editors should offer the short form too."""
        return {"anyOf": [{"type": "string"}, handler(schema)]}


class SearchPlan(Section):
    """How trials are proposed, and how many."""

    strategy: StrictStr = Field(min_length=1, description="a strategy (`halma strategies`)")
    settings: dict[str, JsonValue] = Field(default_factory=dict, description="settings of the strategy")
    first: Points = Field(default=(), description="parameters of the first trials, before the strategy decides")
    trials: Whole | None = Field(default=None, gt=0, description="stop after this many finished trials")
    cost: Finite | None = Field(default=None, gt=0, description="stop when this many simulation samples are spent")

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.trials is None and self.cost is None:
            raise wrong("trials", "expected a budget, `trials` or `cost`, found neither")
        return self


class LaterStage(Section):
    """What every stage after the search says.

    Its `settings` and `training` are laid over the study's, key by key.
    """

    after: Annotated[
        tuple[StrictStr, ...],
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value, json_schema_input_type=Any),
        Field(
            strict=False, min_length=1, description="the stages whose distinct strategies it takes up: a name, or more"
        ),
    ] = (SEARCH,)
    strategies: Whole = Field(default=5, gt=0, description="at most so many of them, best first")
    settings: dict[str, JsonValue] = Field(default_factory=dict, description="settings of the task in this stage")
    training: dict[str, JsonValue] = Field(default_factory=dict, description="training settings of this stage")

    @field_validator("training")
    @classmethod
    def _training(cls, training: dict[str, Any]) -> dict[str, Any]:
        _positive_budget(training)
        return training


class NoveltyStage(LaterStage):
    """Trainings from each strategy, rewarded for being unlike all that is known."""

    kind: Literal["novelty"]
    trainings: Whole = Field(default=5, gt=0, le=1000, description="from each strategy (k)")
    threshold: Finite = Field(
        default=math.pi / 2, gt=0, description="how far from all that is known earns the whole reward (d_threshold)"
    )


MOST_ROUNDS = 1000


class PolishStage(LaterStage):
    """Each strategy trained on until its value stops rising."""

    kind: Literal["polish"]
    rounds: Whole = Field(default=5, gt=0, le=MOST_ROUNDS, description="at most so many trainings, one after the other")
    rise: Finite = Field(default=0.0, ge=0, description="a training that raises the value by no more was the last")


StageChoice = Annotated[NoveltyStage | PolishStage, Field(discriminator="kind")]
"""A stage after the search."""


class Resources(Section):
    """Where and how widely the trials run."""

    parallel: Whole = Field(default=1, gt=0, le=4096, description="trials that run at the same time")
    cpus: Finite = Field(default=1.0, gt=0, description="cores for each trial")
    pool: Name = Field(default="default", description="worker pool that runs the trials")


class Retries(Section):
    """What happens to a trial whose worker vanished or whose task raised an error."""

    limit: Whole = Field(
        default=2,
        ge=0,
        le=100,
        description="further attempts after errors of the task, after losses that got nowhere",
    )
    total: Whole = Field(
        default=30, ge=0, le=10_000, description="further attempts in all (at least the limit), however far each came"
    )
    backoff_seconds: Finite = Field(
        default=1.0, ge=0, description="wait before the first retry; doubles each time, up to a minute"
    )

    @property
    def in_all(self) -> int:
        """Further attempts in all."""
        return max(self.limit, self.total)


def _positive_budget(training: Mapping[str, Any]) -> None:
    """Whatever the task's budget looks like, a figure in it that is not above zero would train nothing."""
    budget = training.get("budget")
    figures = budget if isinstance(budget, Mapping) else {"": budget}
    for name, figure in figures.items():
        if isinstance(figure, int | float) and not isinstance(figure, bool) and figure <= 0:
            field = f"budget.{name}" if name else "budget"
            raise wrong(field, f"expected a number above 0, found {as_written(figure)}")


class StudySpec(Section):
    """One study, as its file asks for it. `space` None means the task's own space, until it is resolved."""

    name: Name = Field(description="the name of the study, unique in its database")
    task: TaskChoice = Field(description="a task: its name, or a mapping of `name` and `settings`")
    space: dict[StrictStr, SpelledParameter] | None = Field(
        default=None, min_length=1, description="what is searched over; default: the task's own space"
    )
    search: SearchPlan = Field(description="a mapping of `strategy`, `settings` and `trials` or `cost`")
    stages: dict[Name, StageChoice] = Field(
        default_factory=dict, description="what follows the search, by name: `kind` novelty or polish, `after`, ..."
    )
    training: dict[str, JsonValue] = Field(
        default_factory=dict, description="budget, network and learner settings, validated by the task"
    )
    resources: Resources = Resources()
    profile: StrictStr | None = Field(default=None, description="which of the file's profiles runs (`--profile`)")
    seed: Whole = Field(default=0, ge=0, le=LARGEST_SEED, description="all randomness of the study flows from it")
    priority: Whole = Field(default=0, ge=-1000, le=1000, description="studies of higher priority get slots first")
    share: Finite = Field(
        default=1.0,
        gt=0,
        le=1000,
        description="of the core-seconds of its pool and priority: 2 gets twice 1",
    )
    retries: Retries = Retries()
    stop_after_failures: Whole = Field(
        default=5, gt=0, description="stop the study when so many trials in a row failed"
    )

    keep_checkpoints: StrictBool = Field(
        default=False, description="keep the checkpoints of trials that have ended; by default they are removed"
    )

    @field_validator("training")
    @classmethod
    def _training(cls, training: dict[str, Any]) -> dict[str, Any]:
        _positive_budget(training)
        return training

    @model_validator(mode="after")
    def _stages(self) -> Self:
        if not self.stages:
            return self
        known = [SEARCH, *self.stages]
        if SEARCH in self.stages:
            raise wrong(f"stages.{SEARCH}", f"expected another name, found {SEARCH}, which is that of the first stage")
        for name, stage in self.stages.items():
            for place, earlier in enumerate(stage.after):
                if earlier not in known or earlier == name:
                    others = [each for each in known if each != name]
                    raise wrong(
                        f"stages.{name}.after", f"expected another stage, found {earlier}; {nearest(earlier, others)}"
                    )
                if earlier in stage.after[:place]:
                    raise wrong(f"stages.{name}.after", f"expected each stage once, found {earlier} twice")
        ordered = in_order({name: stage.after for name, stage in self.stages.items()})
        for name in self.stages:
            if name not in ordered:
                raise wrong(
                    f"stages.{name}.after",
                    f"expected stages that begin before {name}, found that they wait in a circle",
                )
        if self.search.trials is None:
            raise wrong("search.trials", "expected the number of trials after which the later stages begin, found none")
        return self

    def to_json(self) -> dict[str, Any]:
        """The spec as plain JSON values, for the trial database."""
        return self.model_dump(mode="json")

    @classmethod
    def from_json(cls, fields: Mapping[str, Any]) -> StudySpec:
        """The spec that `to_json` wrote, resolved where that one was."""
        return (ResolvedSpec if "behaviour" in fields else StudySpec).model_validate(dict(fields))


class Behaviour(Section):
    """What a behaviour is in a study: the task's `FeatureSpec`, as the study was created with it."""

    kind: Literal["euclidean", "circle", "rotation"]
    names: Strings
    distinct: float
    low: Numbers = ()
    high: Numbers = ()
    unit: str = ""


class ResolvedSpec(StudySpec):
    """A study that can be run: checked against its task and strategy, and holding what it was told by the task.

    A study keeps these, so that a later version of its task doesn't change it, and so that nobody has to import
    the task to draw its results.

    Args:
        space: never None.
        behaviour: the features, or None where behaviour plays no part.
        units: of the parameters, by name; for tables and axes.
        has_difficulty: whether the task has a difficulty.
        trains: whether trials leave policies.
    """

    behaviour: Behaviour | None
    units: dict[str, str]
    has_difficulty: bool
    trains: bool


def json_schema() -> dict[str, Any]:
    """JSON schema of a study file, for editors (`halma schema`)."""
    schema = StudySpec.model_json_schema()
    profiles = {
        "type": "object",
        "description": "sections that a profile changes, by its name; `profile` or `--profile` chooses one",
        "additionalProperties": relaxed(schema),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "properties": {**schema["properties"], PROFILES: profiles},
    }
