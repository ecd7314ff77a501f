"""The application: every command under its name."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import typer

from services.cli import about, checking, files, keeping, plotting, poses, starting, studies
from services.cli.session import ask_server

EPILOG = (
    "Places: HALMA_HOME (default ~/.halma), HALMA_DB, HALMA_ARTIFACTS, HALMA_SERVER. "
    "Exit codes: 0 done, 2 bad input, 1 anything else, 130 interrupted."
)

app = typer.Typer(
    name="halma",
    help="Search for motor skills: diversity and hyperparameter search over deep-RL trainings in physics simulation.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        try:
            number = version("halma")
        except PackageNotFoundError:
            number = "(not installed)"
        typer.echo(f"halma {number}")
        raise typer.Exit


@app.callback()
def halma(
    show_version: Annotated[  # noqa: ARG001 - its callback prints it
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
    server: Annotated[
        str | None,
        typer.Option(
            "--server",
            metavar="URL",
            help="Ask the service there instead of a database here; its token is HALMA_TOKEN or in HALMA_HOME/token.  "
            "[default: HALMA_SERVER]",
        ),
    ] = None,
) -> None:
    """Options of the command itself."""
    ask_server(server)


for group, commands in (
    ("Start", (starting.run, starting.serve, starting.submit)),
    (
        "Look",
        (
            studies.ls,
            studies.show,
            studies.trials,
            studies.watch,
            keeping.replay,
            keeping.audit,
            plotting.plot,
            keeping.export,
        ),
    ),
    ("Steer", (studies.pause, studies.resume, studies.cancel, studies.extend)),
    ("Know", (about.tasks, about.strategies, about.schema, about.doctor)),
):
    for command in commands:
        app.command(rich_help_panel=group)(command)
app.command("set", rich_help_panel="Steer")(studies.set_fields)
app.command("gc", rich_help_panel="Keep")(files.gc)
app.command("verify", rich_help_panel="Keep")(files.verify_files)
app.add_typer(poses.app, name="poses", rich_help_panel="Know")
app.add_typer(checking.task, name="task", rich_help_panel="Know")
app.add_typer(about.database, name="db", rich_help_panel="Know")
