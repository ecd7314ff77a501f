"""Code that people bring: importing it, and telling what went wrong in it without our own frames."""

from __future__ import annotations

import difflib
import importlib
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from workers.contracts import BadJob

_OURS = Path(__file__).resolve().parent


class UnknownTask(BadJob):
    """No task of that name."""


class TaskImportFailed(BadJob):
    """The user's module raised while it was imported.

    Args:
        name: the task as the study file writes it.
        trace: the user's traceback, our frames left out.
    """

    def __init__(self, name: str, trace: str) -> None:
        super().__init__(f"task {name!r}: its module could not be imported\n{trace}")
        self.trace = trace


class EnvironmentFailed(BadJob):
    """The user's environment raised while it was made.

    Args:
        name: the task as the study file writes it.
        trace: the user's traceback, our frames left out.
    """

    def __init__(self, name: str, trace: str) -> None:
        super().__init__(f"task {name!r}: its environment could not be made\n{trace}")
        self.trace = trace


def user_traceback(error: BaseException) -> str:
    """The traceback of an error in the user's code, without our frames and without those of the import system."""
    report = traceback.TracebackException.from_exception(error)
    link: traceback.TracebackException | None = report
    while link is not None:
        link.stack = traceback.StackSummary.from_list([f for f in link.stack if not _is_ours(f.filename)])
        link = link.__cause__ or link.__context__
    return "".join(report.format()).rstrip()


def where(error: BaseException) -> str:
    """The error in one line: type, message, and the last line of the user's own code."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _is_ours(f.filename)]
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"


def _is_ours(filename: str) -> bool:
    return filename.startswith("<frozen importlib") or (
        filename.endswith(("importlib/__init__.py", "importlib/metadata/__init__.py"))
        or Path(filename).resolve().is_relative_to(_OURS)
    )


def import_attribute(name: str) -> Any:
    """What `module:attribute` names, the working directory being searched last.

    Raises:
        UnknownTask: no such module or attribute; the nearest names are told.
        TaskImportFailed: the module raised.
    """
    module_name, _, attribute = name.partition(":")
    found: Any = import_module(name, module_name)
    for part in attribute.split("."):
        if not hasattr(found, part):
            raise UnknownTask(f"task {name!r}: {module_name!r} has no {part!r}{suggestion(part, vars(found))}")
        found = getattr(found, part)
    return found


def import_module(name: str, module_name: str) -> ModuleType:
    """The module that task `name` needs; see `import_attribute`."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last, so that a file of theirs never hides a module of the standard library
    importlib.invalidate_caches()
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            raise UnknownTask(
                f"task {name!r}: expected an importable module, found no module named {error.name!r}; "
                f"run from the folder that holds it ({here} was searched), or install its package"
            ) from None
        raise TaskImportFailed(name, user_traceback(error)) from None
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a module may raise anything, and it is told to the user
        raise TaskImportFailed(name, user_traceback(error)) from None


def suggestion(name: str, known: Iterable[str]) -> str:
    """`; did you mean ...?` with up to three of the nearest names, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(repr(n) for n in near)}?" if near else ""
