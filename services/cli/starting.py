"""Commands that start studies: run, submit, and the service itself."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer

from services.admission import admit, apply_changes, changes_of, find
from services.artifacts.root import settle
from services.cli.driving import drive_here, refuse_driven
from services.cli.findings import report
from services.cli.session import (
    Artifacts,
    AsJson,
    Db,
    RayAddress,
    TakeOver,
    named_server,
    only_here,
    print_json,
    say,
    session,
    warn,
)
from services.errors import BadInput, NameTaken
from services.problems import BadStudy
from services.settings import find_settings
from services.spec_file import read_draft
from services.states import StudyState

File = Annotated[Path, typer.Argument(metavar="FILE", help="Study file (YAML); `halma schema` describes it.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="FIELD=VALUE", help="Override a field, e.g. search.trials=4.")
]
Profile = Annotated[
    str | None, typer.Option("--profile", metavar="NAME", help="Which of the file's profiles to run, e.g. quick.")
]
NewName = Annotated[str | None, typer.Option("--name", help="Name of the study, instead of the one in the file.")]


def run(
    file: File,
    profile: Profile = None,
    overrides: Overrides = None,
    name: NewName = None,
    inline: Annotated[bool, typer.Option("--inline", help="Run trials in this process, without Ray.")] = False,
    take_over: TakeOver = False,
    cores: Annotated[int | None, typer.Option("--cores", min=1, help="Cores to use; default: all.")] = None,
    ray: RayAddress = None,
    db: Db = None,
    artifacts: Artifacts = None,
) -> None:
    """Run a study here: start it, resume it where it was interrupted, or show it where it is finished."""
    from services.spec_check import check  # noqa: PLC0415 - the search and the task, which take seconds to import

    read = read_draft(file, _overridden_by(overrides, name, profile))
    spec = check(read)
    with session(db, artifacts, here="run") as opened:
        settle(opened.store, opened.artifacts)
        row = find(opened.store, spec.name)
        if row is None:
            admit(opened.store, spec)
        else:
            origin, anew = read.source.origin(("name",)), f"halma run {file} --name NEW"
            changes = changes_of(row, read.spec or spec, origin, anew)
            if not take_over:
                refuse_driven(opened, row)
            if changes:
                row = apply_changes(opened.store, row, changes)
                say(f"{row.name} changes with its file: {'; '.join(changes.words)}")
            if row.state is StudyState.COMPLETE:
                report(opened, row)
                return
        drive_here(opened, spec.name, inline=inline, take_over=take_over, cores=cores, ray_address=ray)


def submit(
    file: File,
    profile: Profile = None,
    overrides: Overrides = None,
    name: NewName = None,
    server: Annotated[
        str | None, typer.Option("--server", help="URL of the service; default: the one of this home.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hand a study to a running service (`halma serve`)."""
    from services.client import Client  # noqa: PLC0415 - HTTP, which other commands don't speak

    settings = find_settings()
    server = server or named_server()
    given = _overridden_by(overrides, name, profile)
    # What can be told from the form alone is told here, also where no service runs; the rest is the service's to check.
    read = read_draft(file, given)
    if read.problems:
        raise BadStudy(read.problems)
    with Client(settings, server) as client:
        try:
            study = client.submit(file.read_text(encoding="utf-8"), given, str(file))
        except NameTaken as error:
            raise NameTaken(f"{read.source.origin(('name',))}: {error}") from None
        url = client.url
    if as_json:
        print_json(study.model_dump(mode="json"))
        return
    say(f"Submitted {study.name} to {url}. Follow it: halma watch {study.name}")


def serve(
    host: Annotated[str, typer.Option("--host", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, help="Port; default 8642, and 0 takes a free one.")
    ] = None,
    pools: Annotated[
        list[str] | None,
        typer.Option(
            "--pool",
            metavar="NAME=CORES",
            help="A worker pool; default: default=all cores, or the pools of the cluster as its hosts come and go.",
        ),
    ] = None,
    hosts: Annotated[
        list[str] | None, typer.Option("--allow-host", help="A further name under which browsers reach the service.")
    ] = None,
    pages_only: Annotated[
        bool,
        typer.Option(
            "--pages-only", help="Drive nothing: a service elsewhere on the same database does (no Ray here)."
        ),
    ] = False,
    ray: RayAddress = None,
    db: Db = None,
    artifacts: Artifacts = None,
) -> None:
    """Serve the API and the pages, and drive every study that is submitted, until Ctrl-C."""
    only_here("serve")
    from services import serving  # noqa: PLC0415 - the web framework takes a second to import
    from services.ray_environment import prepare  # noqa: PLC0415 - as above

    if pages_only and (pools or ray is not None):
        raise BadInput("--pages-only: expected neither --pool nor --ray-address beside it: it runs no trials")
    sizes = read_pools(pools or []) or ({"default": os.cpu_count() or 1} if ray is None and not pages_only else None)
    settings = find_settings(db, artifact_root=artifacts)
    listen = serving.PORT if port is None else port

    @contextmanager
    def coordinator() -> Iterator[None]:
        prepare(ray)
        from services.ray_running import coordinator_serving  # noqa: PLC0415 - Ray reads the environment on import

        folder = str(Path.cwd())
        with coordinator_serving(settings.database, settings.artifacts, folder, sizes, ray_address=ray, tell=warn):
            yield

    drive = nullcontext if pages_only else coordinator
    serving.serve(settings, start_coordinator=drive, say=say, host=host, port=listen, hosts=hosts or [], pools=sizes)


def _overridden_by(overrides: list[str] | None, name: str | None, profile: str | None) -> list[str]:
    """All that the command line says of a study's fields, as overrides."""
    return [
        *(overrides or []),
        *([f"name={json.dumps(name)}"] if name is not None else []),
        *([f"profile={profile}"] if profile is not None else []),
    ]


def read_pools(texts: list[str]) -> dict[str, int]:
    """`["default=2", "gpu=1"]` as cores by pool. Raises `BadInput`."""
    pools: dict[str, int] = {}
    for text in texts:
        pool, _, size = text.partition("=")
        if not pool or not size.isascii() or not size.isdigit() or int(size) < 1:
            raise BadInput(f"--pool: expected NAME=CORES such as default=4, found {text}")
        if pool in pools:
            raise BadInput(f"--pool: expected each pool once, found {pool} twice")
        pools[pool] = int(size)
    return pools
