"""Commands that tell what there is: tasks, strategies, schema, doctor; and the one that upgrades a database."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer
from rich.text import Text

from search import strategies as all_strategies
from services.cli.layout import plain_table
from services.cli.session import AsJson, Db, console, print_json, say
from services.cli.words import value_of
from services.doctor import Check, examine
from services.errors import BadInput, HalmaError
from services.problems import nearest
from services.settings import find_settings
from services.spec import json_schema
from services.store.open import upgrade
from workers.contracts import BadJob, ParameterSpec, TaskInfo
from workers.registry import list_tasks, load_task


class Unhealthy(HalmaError):
    """Something that halma needs is missing."""


def tasks(
    name: Annotated[str | None, typer.Argument(metavar="TASK", help="One task in full; default: list them.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the tasks, or show one with its parameters and settings."""
    if name is None:
        infos = list(list_tasks())
        if as_json:
            print_json([asdict(info) for info in infos])
            return
        table = plain_table()
        for head in ("task", "what it is", "parameters", "behaviour"):
            table.add_column(head, no_wrap=head == "task")
        for info in infos:
            behaviour = "-" if info.features is None else f"{', '.join(info.features.names)} ({info.features.kind})"
            table.add_row(info.name, Text(info.summary), ", ".join(info.parameters) or "-", behaviour)
        console().print(table)
        say()
        say(
            "One in full: halma tasks NAME. Your own: `task: module:attribute` in a study file; any gymnasium:ID works."
        )
        return
    try:
        info = load_task(name).info({})
    except BadJob as error:
        raise BadInput(f"tasks: {error}") from None
    if as_json:
        print_json(asdict(info))
    else:
        _show_task(info)


def _show_task(info: TaskInfo) -> None:
    say(f"{info.name}: {info.summary}")
    say()
    table = plain_table()
    for head in ("parameter", "range", "unit"):
        table.add_column(head)
    for name, parameter in info.parameters.items():
        table.add_row(name, _range(parameter), parameter.unit or "-")
    if info.parameters:
        console().print(table)
        say()
    if info.features is not None:
        unit = f" {info.features.unit}" if info.features.unit else ""
        say(
            f"Behaviour: {', '.join(info.features.names)} ({info.features.kind}); "
            f"further apart than {info.features.distinct:g}{unit} is another strategy"
        )
    say(f"Difficulty: {'yes' if info.has_difficulty else 'no'}. Learns a policy: {'yes' if info.trains else 'no'}.")
    for title, fields in (("Settings", info.settings), ("Training", info.training)):
        if fields:
            say()
            say(f"{title} (defaults):")
            for line in _lines(fields):
                say(f"  {line}")


def _range(parameter: ParameterSpec) -> str:
    if parameter.kind == "angle":
        return "angle"
    if parameter.kind == "categorical":
        return ", ".join(parameter.choices)
    words = f"{value_of(parameter.low)} to {value_of(parameter.high)}"
    return f"{words}{', whole' if parameter.kind == 'int' else ''}{', log' if parameter.log else ''}"


def _lines(fields: Any, indent: str = "") -> list[str]:
    lines = []
    for name, value in fields.items():
        if isinstance(value, dict):
            lines += [f"{indent}{name}:", *_lines(value, f"{indent}  ")]
        else:
            lines.append(f"{indent}{name}: {value_of(value)}")
    return lines


def strategies(
    name: Annotated[str | None, typer.Argument(metavar="STRATEGY", help="One in full; default: list them.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the strategies, or show one with its settings."""
    infos = all_strategies()
    if name is not None:
        chosen = next((info for info in infos if info.name == name), None)
        if chosen is None:
            known = nearest(name, [info.name for info in infos])
            raise BadInput(f"strategies: expected a strategy, found {name}; {known}")
        if as_json:
            print_json(asdict(chosen))
            return
        say(f"{chosen.name}: {chosen.summary}")
        say()
        table = plain_table()
        for head in ("setting", "kind", "default", "meaning"):
            table.add_column(head)
        for setting in chosen.settings:
            table.add_row(setting.name, Text(setting.kind), Text(value_of(setting.default)), Text(setting.summary))
        console().print(table) if chosen.settings else say("It has no settings.")
        return
    if as_json:
        print_json([asdict(info) for info in infos])
        return
    table = plain_table()
    for head in ("strategy", "what it does", "looks at", "needs"):
        table.add_column(head)
    for info in infos:
        looks = [
            word
            for word, looked in (
                ("value", info.uses_values),
                ("behaviour", info.uses_features),
                ("difficulty", info.uses_z),
            )
            if looked
        ]
        table.add_row(
            info.name,
            Text(info.summary),
            ", ".join(looks) or "-",
            Text(f"pip install halma[{info.extra}]" if info.extra else "-"),
        )
    console().print(table)
    say()
    say("One with its settings: halma strategies NAME")


def schema() -> None:
    """Print the JSON schema of study files, for editors."""
    print_json(json_schema())


def doctor(db: Db = None, as_json: AsJson = False) -> None:
    """Look whether everything halma needs is there, with a remedy for what is not."""
    checks = examine(find_settings(db))
    if as_json:
        print_json([asdict(check) for check in checks])
    else:
        for check in checks:
            _show_check(check)
    bad = [check.name for check in checks if not check.good]
    if bad:
        raise Unhealthy(f"doctor: {', '.join(bad)} need{'s' if len(bad) == 1 else ''} attention")


def _show_check(check: Check) -> None:
    mark = Text("ok  ", style="green") if check.good else Text("bad ", style="red")
    console().print(mark + Text(f"{check.name.ljust(12)} {check.found}"))
    if not check.good:
        say(f"      do: {check.remedy}")


database = typer.Typer(help="The trial database.", no_args_is_help=True)


@database.command("upgrade")
def db_upgrade(db: Db = None) -> None:
    """Bring the trial database to the schema of this halma (a SQLite file is copied first)."""
    settings = find_settings(db)
    settings.home.mkdir(parents=True, exist_ok=True)
    before = upgrade(settings.database)
    say(f"The schema is up to date (it was {before or 'empty'}).")
