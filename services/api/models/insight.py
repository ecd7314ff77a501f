"""What a search has learnt."""

from __future__ import annotations

from pydantic import Field, JsonValue

from services.api.models.basis import Model, Page
from services.states import TrialState


class AxisOut(Model):
    """One side of a slice."""

    name: str
    label: str
    unit: str
    scale: str = Field(description="linear, log, angle or category")
    values: list[JsonValue] = Field(description="natural units, ascending")


class OutputOut(Model):
    """What a slice shows."""

    name: str
    label: str
    unit: str


class SampleOut(Model):
    """A finished trial beside a slice."""

    number: int
    x: JsonValue
    y: JsonValue
    z: float | None
    value: float | None = Field(description="of the output, as observed")
    state: TrialState
    near: float = Field(description="correlation with its foot on the slice, in [0, 1]; 1 lies on it")


class PendingOut(Model):
    """An open trial on a slice."""

    number: int
    x: JsonValue
    y: JsonValue
    z: float | None
    state: TrialState


class NextOut(Model):
    """What the strategy would propose now."""

    x: JsonValue
    y: JsonValue
    params: dict[str, JsonValue]
    z: float | None
    info: dict[str, JsonValue]


class SliceOut(Model):
    """A slice of a surrogate. Matrices have one row for each value of y and one column for each of x."""

    x: AxisOut
    y: AxisOut | None = Field(description="none in a space of one parameter; then matrices have one row")
    output: OutputOut
    z: float
    mean: list[list[float]] = Field(description="natural units of the output; empty before anything is known")
    deviation: list[list[float]] = Field(description="standard deviation of the mean, the same unit")
    acquisition: list[list[float]] | None = Field(description="what the study's strategy maximises")
    acquisition_name: str
    samples: list[SampleOut]
    pending: list[PendingOut]
    next: NextOut | None = Field(description="none where it isn't worked out, or nothing more is proposed")
    others: dict[str, JsonValue] = Field(description="the parameters that stay, natural units")
    observations: int = Field(description="how many finished trials the surrogate knows")
    note: str


class ImportanceOut(Model):
    """How much one parameter matters."""

    name: str
    label: str
    unit: str
    length_scale: float = Field(description="in ranges of the parameter")
    from_length_scales: float = Field(description="share of all inverse length scales; they sum to 1")
    permutation: float = Field(description="rise of the squared error when it is permuted, in variances of the output")
    interval: list[float] = Field(description="95 % of the bootstraps of that: low, high", min_length=2, max_length=2)


class BestOut(Model):
    """The best trial at full difficulty."""

    number: int
    value: float
    params: dict[str, JsonValue]
    yaml: str = Field(description="a `space` section around it, for the next study file")


class ImportanceList(Model):
    """Which parameters matter, the most important first."""

    of: str = Field(description="value or behaviour")
    parameters: list[ImportanceOut]
    agreement: float | None = Field(description="rank correlation of the two importances")
    explained: float | None = Field(description="share of the variance that the surrogate predicts unseen")
    observations: int
    best: BestOut | None
    note: str


class LevelOut(Model):
    """What one difficulty cost."""

    z: float
    trials: int
    finished: int
    samples: int
    seconds: float
    best: float | None


class LadderPoint(Model):
    """A trial on the ladder."""

    number: int
    z: float | None
    value: float | None
    samples: int
    state: TrialState


class Ladder(Page):
    """Difficulties, easiest first, and trials by number."""

    levels: list[LevelOut]
    points: list[LadderPoint]


class NodeOut(Model):
    """A trial that was warm-started, or that another was warm-started from."""

    number: int
    z: float | None
    value: float | None
    state: TrialState
    stage: str
    samples: int


class EdgeOut(Model):
    """Whose policy a trial started from."""

    parent: int
    child: int


class Lineage(Page):
    """Who was warm-started from whom. Nodes and edges of a page belong together."""

    nodes: list[NodeOut]
    edges: list[EdgeOut]


class Curve(Model):
    """One metric of one trial."""

    number: int
    state: TrialState
    z: float | None
    value: float | None
    iterations: list[int]
    samples: list[float | None] = Field(description="simulation samples so far, where they were reported")
    values: list[float | None]


class CurveList(Model):
    """Learning curves to be laid over each other."""

    metric: str
    metrics: list[str] = Field(description="what else these trials reported")
    curves: list[Curve]
