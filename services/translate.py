"""Between the vocabularies of the search and of the workers: they never import each other and meet only here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from search import Features, Space, Strategy, make_strategy
from search.given import Given
from search.stages import NoveltyStage, PolishStage, Staged, in_order
from services.spec import (
    AngleParameter,
    Behaviour,
    CategoricalParameter,
    FloatParameter,
    IntParameter,
    Parameter,
    ResolvedSpec,
    StudySpec,
)
from services.store.port import TrialRow
from workers.contracts import FeatureSpec, Job, ParameterSpec, TaskInfo


def parameter_of(spec: ParameterSpec) -> Parameter:
    """A task's parameter in the words of study files."""
    if spec.kind == "angle":
        return AngleParameter(type="angle")
    if spec.kind == "categorical":
        return CategoricalParameter(type="categorical", choices=spec.choices)
    if spec.low is None or spec.high is None:
        raise ValueError(f"expected a {spec.kind} parameter with low and high, found {spec}")
    if spec.kind == "int":
        return IntParameter(type="int", low=int(spec.low), high=int(spec.high), log=spec.log)
    return FloatParameter(type="float", low=spec.low, high=spec.high, log=spec.log)


def parameter_spec_of(parameter: Parameter) -> ParameterSpec:
    """A study's parameter in the words of tasks; the reverse of `parameter_of`."""
    fields = parameter.model_dump()
    return ParameterSpec(**{"kind" if name == "type" else name: value for name, value in fields.items()})


def behaviour_of(features: FeatureSpec | None) -> Behaviour | None:
    """A task's features in the words of studies."""
    if features is None:
        return None
    return Behaviour(
        kind=features.kind,
        names=features.names,
        distinct=features.distinct,
        low=features.low,
        high=features.high,
        unit=features.unit,
    )


def resolve(spec: StudySpec, info: TaskInfo) -> ResolvedSpec:
    """A study with what its task says filled in.

    Raises:
        ValueError: neither the study nor the task has a space.
    """
    space = spec.space
    if space is None:
        if not info.parameters:
            raise ValueError(f"expected a space, because {info.name} has none of its own, found nothing")
        space = {name: parameter_of(parameter) for name, parameter in info.parameters.items()}
    return ResolvedSpec(
        **{name: getattr(spec, name) for name in StudySpec.model_fields if name != "space"},
        space=space,
        behaviour=behaviour_of(info.features),
        units={name: parameter.unit for name, parameter in info.parameters.items() if parameter.unit and name in space},
        has_difficulty=info.has_difficulty,
        trains=info.trains,
    )


def search_space(spec: ResolvedSpec) -> Space:
    """The study's space in the search's words.

    Parameters are in alphabetical order: databases may forget the order of a JSON object, a proposal depends on it.
    """
    fields = {name: parameter.model_dump() for name, parameter in sorted((spec.space or {}).items())}
    return Space.from_specs({name: {**each, "kind": each["type"]} for name, each in fields.items()})


def search_features(behaviour: Behaviour | None) -> Features | None:
    """The study's behaviour in the search's words."""
    if behaviour is None:
        return None
    if behaviour.kind == "circle":
        return Features.circle()
    if behaviour.kind == "rotation":
        return Features.rotation()
    return Features.euclidean(len(behaviour.names), low=behaviour.low or 0.0, high=behaviour.high or 1.0)


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with others laid over them: mappings key by key, everything else replaced."""
    merged = dict(below)
    for key, value in above.items():
        inner = merged.get(key)
        merged[key] = laid_over(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return merged


def settings_in(spec: StudySpec, stage: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of the task, and of the training, in a stage."""
    later = spec.stages.get(stage)
    if later is None:
        return dict(spec.task.settings), dict(spec.training)
    return laid_over(spec.task.settings, later.settings), laid_over(spec.training, later.training)


def job_of(spec: StudySpec, trial: TrialRow) -> Job:
    """What a worker runs for a trial; also what a policy is simulated again from."""
    settings, training = settings_in(spec, trial.stage)
    away = {name: trial.info[name] for name in ("avoid", "threshold", "strategies") if name in trial.info}
    return Job(
        study=spec.name,
        trial=trial.number,
        task=spec.task.name,
        task_settings=settings,
        training=training,
        novelty=away if {"avoid", "threshold"} <= away.keys() else None,
        params=dict(trial.params),
        z=trial.z,
        seed=trial.seed,
        parent=trial.warm_start,
    )


def strategy_settings(spec: StudySpec) -> dict[str, Any]:
    """The strategy's settings; one that plans a cost budget is told of the study's."""
    settings = dict(spec.search.settings)
    if spec.search.cost is not None and "cost_budget" not in settings and _plans_cost(spec.search.strategy):
        settings["cost_budget"] = spec.search.cost
    return settings


def _plans_cost(strategy: str) -> bool:
    from search.registry import strategy_class  # noqa: PLC0415 - imports the strategy, which may take seconds

    return any(setting.name == "cost_budget" for setting in strategy_class(strategy).info().settings)


def make_strategy_of(spec: ResolvedSpec) -> Strategy:
    """The study's strategy, without the points that it is to begin with. Raises `search.SearchError`."""
    return make_strategy(
        spec.search.strategy,
        search_space(spec),
        features=search_features(spec.behaviour),
        settings=strategy_settings(spec),
    )


def begin_with_points(strategy: Strategy, spec: StudySpec) -> Strategy | Given:
    """The study's strategy, beginning with the points that the study gives. Raises `search.BadParams`."""
    points: tuple[Mapping[str, Any], ...] = spec.search.first
    return Given(strategy, points) if points else strategy


def build_strategy(fields: Mapping[str, Any]) -> Strategy | Given | Staged:
    """The strategy of a study as its row keeps it, with its stages. Raises `search.SearchError`."""
    spec = StudySpec.from_json(fields)
    if not isinstance(spec, ResolvedSpec):
        from workers.registry import load_task  # noqa: PLC0415 - a resolved study, the usual case, needs no task

        spec = resolve(spec, load_task(spec.task.name).info(spec.task.settings))
    search = begin_with_points(make_strategy_of(spec), spec)
    metric = search_features(spec.behaviour)
    if not spec.stages or spec.search.trials is None or metric is None or spec.behaviour is None:
        return search
    return Staged(search, spec.search.trials, stages_of(spec), metric, spec.behaviour.distinct)


def stages_of(spec: StudySpec) -> tuple[NoveltyStage | PolishStage, ...]:
    """The study's later stages in the search's words and in an order in which they can follow each other.

    The order is told by what comes after what: databases may forget that of a JSON object.
    """
    made: list[NoveltyStage | PolishStage] = []
    for name in in_order({name: stage.after for name, stage in spec.stages.items()}):
        stage = spec.stages[name]
        if stage.kind == "novelty":
            made.append(NoveltyStage(name, stage.after, stage.strategies, stage.trainings, stage.threshold))
        else:
            made.append(PolishStage(name, stage.after, stage.strategies, stage.rounds, stage.rise))
    return tuple(made)
