"""Which tasks are there? Built-in ones, those of installed packages, Gymnasium's, and people's own."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from workers.contracts import Task, TaskInfo, WorkerError
from workers.tasks.function import FunctionTask
from workers.user_code import TaskImportFailed, UnknownTask, import_attribute, suggestion, user_traceback

GROUP = "halma.tasks"
"""The entry point group in which a package offers tasks of its own."""

GYMNASIUM = "gymnasium:"

BUILT_IN: Mapping[str, str] = {
    "high_jump": "workers.tasks.high_jump:HighJump",
    "imitation": "workers.tasks.imitation.task:Imitation",
    "obstacle_jump": "workers.tasks.high_jump:ObstacleJump",
    "point_jump": "workers.tasks.point_jump:PointJump",
    "walker": "workers.tasks.walker.task:Walker",
}
"""By name; imported when they are asked for, since physics and torch take seconds to import."""


def load_task(name: str) -> Task:
    """The task that a study file names.

    Args:
        name: a built-in task, one that an installed package offers, `gymnasium:ID`, or `module:attribute`, the
            attribute being a function ``f(params, z) -> value, features``, a `gymnasium.Env` class, or a `Task`.

    Raises:
        UnknownTask: there is none; the nearest names are told.
        TaskImportFailed: the user's module raised; the message holds their traceback.
    """
    if name in BUILT_IN:
        return _as_task(name, import_attribute(BUILT_IN[name]))
    entry = None if ":" in name else _offer(name)
    if entry is not None:
        return _as_task(name, _load_entry(name, entry))
    if name.startswith(GYMNASIUM):
        from workers.tasks.gymnasium_task import registered  # noqa: PLC0415 - torch takes seconds to import

        return registered(name.removeprefix(GYMNASIUM))
    if ":" in name:
        return _as_task(name, import_attribute(name))
    raise UnknownTask(
        f"task {name!r}: unknown{suggestion(name, task_names())}; known are {', '.join(task_names())}, "
        "gymnasium:ID and module:attribute"
    )


def task_names() -> list[str]:
    """Names of the built-in tasks and of those that installed packages offer."""
    return sorted({*BUILT_IN, *(entry.name for entry in entry_points(group=GROUP))})


def list_tasks() -> list[TaskInfo]:
    """All of `task_names` under their default settings. One that can't be loaded says why in its summary."""
    found = []
    for name in task_names():
        try:
            found.append(load_task(name).info({}))
        except WorkerError as error:
            found.append(TaskInfo(name, f"can't be loaded: {str(error).splitlines()[-1]}"))
    return found


@lru_cache(maxsize=1)
def _offered(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:  # noqa: ARG001 - what is installed follows from it
    """What installed packages offer. Looking through all of them takes milliseconds, which each trial would pay."""
    return tuple(entry_points(group=GROUP))


def _offer(name: str) -> EntryPoint | None:
    """What an installed package offers under a name; where it isn't known they are looked through again."""
    for _ in range(2):
        for entry in _offered(tuple(sys.path)):
            if entry.name == name:
                return entry
        _offered.cache_clear()
    return None


def _load_entry(name: str, entry: Any) -> Any:
    try:
        return entry.load()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a module may raise anything, and it is told to the user
        raise TaskImportFailed(name, user_traceback(error)) from None


def _as_task(name: str, found: Any) -> Task:
    """Whatever was named, as a task."""
    if all(callable(getattr(found, method, None)) for method in ("info", "validate", "run")):
        return cast("Task", found() if isinstance(found, type) else found)
    if not isinstance(found, type):
        if callable(found):
            return FunctionTask(name, found)
        raise UnknownTask(
            f"task {name!r}: expected a function, a gymnasium.Env class or a Task, found a {type(found).__name__}"
        )
    from workers.tasks.gymnasium_task import from_class  # noqa: PLC0415 - torch takes seconds to import

    return from_class(name, found)
