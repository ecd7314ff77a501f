"""The second half of reading a study: against its task and its strategy, which know more than the file's form does."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from search import BadParams, SearchError, UnknownStrategy, strategies
from search import BadSetting as BadStrategySetting
from search.registry import strategy_class
from services.located_yaml import Path as Place
from services.problems import BadStudy, Problem
from services.spec import FloatParameter, IntParameter, Parameter, ResolvedSpec, StudySpec, as_written
from services.spec_file import Draft, draft, read_draft
from services.translate import make_strategy_of, resolve, search_space, settings_in
from workers.contracts import BadJob, BadSetting, ParameterSpec, Task, TaskInfo
from workers.registry import load_task
from workers.user_code import UnknownTask

Problems = list[Problem]

NOVELTY = "a function can where it has an argument `avoid`"
"""How a task of one's own gets to know what to keep away from."""

DIFFICULTY = "an argument z of the function or of the environment's constructor, or task.settings.difficulty"
"""How a task of one's own gets a difficulty."""


def load_study(path: Path, overrides: Sequence[str] = ()) -> ResolvedSpec:
    """Read and check a study file. Raises `BadStudy` with all problems at once."""
    return check(read_draft(path, overrides))


def parse_study(text: str, *, name: str, overrides: Sequence[str] = ()) -> ResolvedSpec:
    """Read and check the text of a study file, which errors call `name`. Raises `BadStudy`."""
    return check(draft(text, name=name, overrides=overrides))


def check(read: Draft) -> ResolvedSpec:
    """Check a draft against its task and strategy, also where its form is wrong elsewhere.

    Raises:
        BadStudy: with the problems of the form and these, in the order of the file.
    """
    problems: Problems = list(read.problems)
    _find_strategy(read, problems)
    task, info = _find_task(read, problems)
    if read.spec is None or info is None or task is None:
        raise BadStudy(sorted(problems, key=read.source.order))
    spec = _resolved(read, read.spec, info, problems)
    if spec is not None:
        _ask_task(read, spec, task, problems)
        _compare_space(read, spec, info, problems)
        if not problems:
            _ask_stages(read, spec, task, info, problems)
            _ask_strategy(read, spec, problems)
        if not problems:
            _place_points(read, spec, problems)
    if problems or spec is None:
        raise BadStudy(sorted(problems, key=read.source.order))
    return spec


def _find_strategy(read: Draft, problems: Problems) -> None:
    search = read.data.get("search")
    name = search.get("strategy") if isinstance(search, dict) else None
    if isinstance(name, str) and name:
        try:
            strategy_class(name)
        except SearchError as error:
            problems.append(read.source.problem(("search", "strategy"), str(error)))


def _find_task(read: Draft, problems: Problems) -> tuple[Task | None, TaskInfo | None]:
    task = read.data.get("task")
    short = isinstance(task, str)
    choice = {"name": task} if short else task
    if not isinstance(choice, dict) or not isinstance(choice.get("name"), str) or not choice["name"]:
        return None, None
    place: Place = ("task",) if short else ("task", "name")
    settings = choice.get("settings") or {}
    try:
        found = load_task(choice["name"])
        return found, found.info(settings if isinstance(settings, dict) else {})
    except BadSetting as error:
        problems.append(read.source.problem(_place(error), error.message))
    except UnknownTask as error:
        why = str(error).removeprefix(f"task {choice['name']!r}: ")
        problems.append(read.source.problem(place, f"expected a task, found {choice['name']}: {why}"))
    except BadJob as error:
        problems.append(read.source.problem(place, str(error)))
    return None, None


def _resolved(read: Draft, spec: StudySpec, info: TaskInfo, problems: Problems) -> ResolvedSpec | None:
    try:
        return resolve(spec, info)
    except ValueError as error:
        problems.append(read.source.problem(("space",), str(error)))
        return None


def _ask_task(read: Draft, spec: ResolvedSpec, task: Task, problems: Problems) -> None:
    try:
        task.validate(spec.task.settings, spec.training, list(spec.space or {}))
    except BadSetting as error:
        problems.append(read.source.problem(_place(error), error.message))
    except BadJob as error:
        problems.append(read.source.problem(("task",), str(error)))


def _compare_space(read: Draft, spec: ResolvedSpec, info: TaskInfo, problems: Problems) -> None:
    """Whether the task can do all that the study may ask of it; a default space always can."""
    for name, found in (spec.space or {}).items():
        known = info.parameters.get(name)
        if known is None:
            continue  # the task says itself which names it takes
        if (found.type == "categorical") != (known.kind == "categorical"):
            kinds = "categorical" if known.kind == "categorical" else "float, int or angle"
            problems.append(read.source.problem(("space", name, "type"), f"expected {kinds}, found {found.type}"))
            continue
        low, high = (-math.pi, math.pi) if found.type == "angle" else bounds_of(found)
        for end, value, bad in (
            ("low", low, known.least is not None and low < known.least),
            ("high", high, known.most is not None and high > known.most),
        ):
            if bad:
                place: Place = ("space", name) if found.type == "angle" else ("space", name, end)
                span = f"{_span(known)} {known.unit}".rstrip()
                message = (
                    f"expected {span}, found {as_written(value)}; {info.name} can do no more: give it a smaller range"
                )
                if known.low is not None and known.high is not None:
                    message += f", usual is {known.low:g} to {known.high:g}"
                problems.append(read.source.problem(place, message))


def bounds_of(parameter: Parameter) -> tuple[float, float]:
    """Lowest and highest value of a numeric parameter; of no other."""
    return (parameter.low, parameter.high) if isinstance(parameter, FloatParameter | IntParameter) else (0.0, 0.0)


def _span(known: ParameterSpec) -> str:
    if known.least is None or known.most is None:
        return f"at least {known.least:g}" if known.least is not None else f"at most {known.most:g}"
    return f"from {known.least:g} to {known.most:g}"


def _ask_stages(read: Draft, spec: ResolvedSpec, task: Task, info: TaskInfo, problems: Problems) -> None:
    """Whether the later stages make sense for the task, under their own settings too."""
    if spec.stages and info.features is None:
        message = (
            f"expected a task with a behaviour, which tells strategies apart, found {spec.task.name}, which has none"
        )
        problems.append(read.source.problem(("stages",), message))
        return
    for name, stage in spec.stages.items():
        settings, training = settings_in(spec, name)
        try:
            found = task.info(settings)
            task.validate(settings, training, list(spec.space or {}))
        except BadSetting as error:
            section = error.section.rpartition(".")[2]
            place = ("stages", name, *_place(BadSetting(section, error.field, error.message)))
            problems.append(read.source.problem(place, error.message))
            continue
        except BadJob as error:
            problems.append(read.source.problem(("stages", name), str(error)))
            continue
        if found.features != info.features:
            message = "expected settings that leave the behaviour what it is, found that they make it another one"
            problems.append(read.source.problem(("stages", name, "settings"), message))
        if stage.kind == "novelty" and not info.seeks_novelty:
            message = f"expected a task that can be trained for novelty, found {spec.task.name}, which can't; {NOVELTY}"
            problems.append(read.source.problem(("stages", name, "kind"), message))


def _ask_strategy(read: Draft, spec: ResolvedSpec, problems: Problems) -> None:
    strategy = spec.search.strategy
    if not spec.has_difficulty and strategy_class(strategy).info().uses_z:
        plain = [
            each.name
            for each in strategies()
            if each.uses_values and not each.uses_z and (spec.behaviour is not None or not each.uses_features)
        ]
        message = (
            f"expected a task with a difficulty for {strategy}, found that {spec.task.name} has none; give it one "
            f"({DIFFICULTY}), or choose a strategy that needs none: {', '.join(plain)}"
        )
        problems.append(read.source.problem(("search", "strategy"), message))
        return
    try:
        make_strategy_of(spec)
    except BadStrategySetting as error:
        if error.field == "features":
            message = (
                f"expected a strategy that needs no behaviour, because the task {spec.task.name} has none, "
                f"found {spec.search.strategy}"
            )
            problems.append(read.source.problem(("search", "strategy"), message))
        else:
            problems.append(read.source.problem(("search", "settings", error.field), error.message))
    except UnknownStrategy as error:
        problems.append(read.source.problem(("search", "strategy"), str(error)))
    except SearchError as error:
        problems.append(read.source.problem(("space",), str(error)))


def _place_points(read: Draft, spec: ResolvedSpec, problems: Problems) -> None:
    """Whether the points to begin with are of the space."""
    space = search_space(spec)
    for i, point in enumerate(spec.search.first):
        try:
            space.to_unit(point)
        except BadParams as error:
            problems.append(read.source.problem(("search", "first", i), str(error)))


def _place(error: BadSetting) -> Place:
    """Where in a study file a task's complaint belongs."""
    section: Place = tuple(error.section.split("."))
    parts = re.findall(r"[^.\[\]]+", error.field)
    # `hidden[0]` is the first entry of the list `hidden`, which has a line of its own
    return (*section, *(int(part) if part.isdigit() else part for part in parts))
