"""The service: API, pages and coordinator in one process, on one port."""

from __future__ import annotations

import errno
import ipaddress
import json
import os
import socket
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import uvicorn

from services.address import read_server
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.artifacts.root import settle
from services.auth import load_or_create_token
from services.errors import BadInput
from services.running import leaving_on_signals
from services.settings import Settings
from services.store.open import open_store

PORT = 8642
FACTORY = "dashboards.app:create_app"
"""Makes the web application. Named and not imported: the dashboards stand above the services."""

SHUTDOWN_SECONDS = 5
"""How long requests in progress may take once the service is told to stop; sockets are closed at once."""


def serve(
    settings: Settings,
    *,
    start_coordinator: Callable[[], AbstractContextManager[None]],
    say: Callable[[str], None],
    host: str = "127.0.0.1",
    port: int = PORT,
    hosts: Collection[str] = (),
    pools: Mapping[str, int] | None = None,
    factory: str = FACTORY,
) -> None:
    """Serve until Ctrl-C or SIGTERM.

    Args:
        settings: home, trial database and artifacts.
        start_coordinator: drives what is submitted, while its context lasts.
        say: prints a line for people.
        host: address to listen on; this machine alone by default.
        port: to listen on; 0 takes a free one.
        hosts: further names under which browsers may address the service.
        pools: cores by worker pool, to be shown.
        factory: `module:function` that makes the web application.

    Raises:
        BadInput: the port is taken, the address is none of this machine's, or a service of this home works on this
            database already.
        DatabaseUnavailable: the trial database can't be opened.
        ArtifactsMoved: the artifacts are not where the record knows them.
    """
    running = read_server(settings.server_file)
    if running is not None and running.database == settings.database and running.pid != os.getpid():
        raise BadInput(
            f"expected no service for {settings.database}, found one at {running.url} (process {running.pid}); "
            f"use it, or stop it with `kill {running.pid}`"
        )
    with listening(host, port, settings) as listener:
        token = load_or_create_token(settings.home)
        store = open_store(settings.database)
        artifacts = open_artifacts(settings.artifacts)
        try:
            settle(store, artifacts)
            app = load_factory(factory)(
                store,
                artifacts,
                token=token.token,
                submit=submit_to(store),
                hosts=[*hosts, host],
                pools=pools,
            )
            config = uvicorn.Config(
                app,
                log_level="warning",
                access_log=False,
                ws="websockets-sansio",
                # Frames are small; compressing them costs each viewer memory and each frame time.
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=SHUTDOWN_SECONDS,
            )
            server = uvicorn.Server(config)
            url = base_url(host, listener.getsockname()[1])

            def leave() -> None:
                server.should_exit = True

            with leaving_on_signals(leave), start_coordinator(), announced(settings, url):
                say(f"halma is at {url}")
                if token.created:
                    say(f"Access token (shown this once, kept in {token.path}): {token.token}")
                else:
                    say(f"Log in with the access token in {token.path}")
                if not is_loopback(host):
                    say("Other machines can reach it, and the connection is not encrypted: put a TLS proxy in front.")
                # uvicorn takes the signals while it runs, and hands them on to `leave` when it has stopped.
                server.run(sockets=[listener])
                say("Stopping: running trainings come to their next checkpoints.")
        finally:
            store.close()


@contextmanager
def listening(host: str, port: int, settings: Settings) -> Iterator[socket.socket]:
    """A socket that listens there. Taken before anything else is started, so that a taken port costs nothing.

    Raises:
        BadInput: it can't be had; says who has it, where that is known, and what to do.
    """
    if not 0 <= port <= 65535:
        raise BadInput(f"--port {port}: expected a port from 0 (any free one) to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise BadInput(f"--host {host}: expected an address of this machine, found: {error}") from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(address)
            listener.listen(128)
        except OSError as error:
            raise BadInput(_why_not(error, host, port, settings)) from None
        yield listener
    finally:
        listener.close()


def _why_not(error: OSError, host: str, port: int, settings: Settings) -> str:
    if error.errno == errno.EADDRINUSE:
        other = read_server(settings.server_file)
        ours = other is not None and other.url.endswith(f":{port}")
        who = f"halma itself (process {other.pid})" if other is not None and ours else "another program"
        stop = (
            f"stop it with `kill {other.pid}`"
            if other is not None and ours
            else f"find it with `ss -ltnp '( sport = :{port} )'`"
        )
        return (
            f"--port {port}: expected a free port on {host}, found it used by {who}; {stop}, or take another (--port)"
        )
    if error.errno == errno.EACCES:
        return f"--port {port}: expected a port this user may listen on, found none; take one above 1023"
    return f"--host {host}: expected an address of this machine, found: {error.strerror or error}"


def base_url(host: str, port: int) -> str:
    """Where programs of this machine find the service."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"http://{host}:{port}"
    if address.is_unspecified:
        return f"http://127.0.0.1:{port}"
    return f"http://[{host}]:{port}" if address.version == 6 else f"http://{host}:{port}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach that address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


@contextmanager
def announced(settings: Settings, url: str) -> Iterator[None]:
    """`server.json` in the home folder while the block runs: where the service is, for `halma submit`."""
    file = settings.server_file
    fresh = file.with_name(f".{file.name}-{os.getpid()}")
    fresh.write_text(
        json.dumps({"url": url, "pid": os.getpid(), "database": settings.database}) + "\n", encoding="utf-8"
    )
    fresh.replace(file)
    try:
        yield
    finally:
        _withdraw(file)


def _withdraw(file: Path) -> None:
    """Remove what we announced, and not what another service has announced since."""
    found = read_server(file)
    if found is not None and found.pid == os.getpid():
        file.unlink(missing_ok=True)


def load_factory(name: str) -> Callable[..., Any]:
    """The function that `module:function` names."""
    module, _, function = name.partition(":")
    made: Callable[..., Any] = getattr(import_module(module), function)
    return made
