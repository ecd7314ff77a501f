"""Driving studies from the command line: with Ray, or inline for tests and debuggers."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from services.artifacts.open import open_artifacts
from services.coordinator import Coordinator
from services.dispatch.inline import InlineDispatcher
from services.driver import driving_words, lives
from services.errors import HalmaError, InterruptedByUser
from services.held import Tell
from services.proposing import InlineStrategist
from services.ray_environment import prepare
from services.states import StudyState
from services.store.open import open_store
from services.store.port import StudyRow

INTERRUPTED = "interrupted"


class TakenOver(HalmaError):
    """Another process has taken the study over."""


Leave = Callable[[], None]


@contextmanager
def leaving_on_signals(leave: Leave) -> Iterator[None]:
    """The first Ctrl-C or SIGTERM asks politely, the second one ends at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen = 0

    def on_signal(signum: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the shape of a handler
        nonlocal seen
        seen += 1
        if seen > 1:
            logging.disable()  # libraries that it falls into would report it as a fault of theirs, traceback and all
            raise KeyboardInterrupt
        leave()

    told = logging.root.manager.disable
    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        logging.disable(told)
        for number, handler in before.items():
            signal.signal(number, handler)


def drive(
    database: str,
    artifact_root: str,
    name: str,
    *,
    inline: bool = False,
    pools: Mapping[str, int] | None = None,
    take_over: bool = False,
    ray_address: str | None = None,
    tell: Tell = lambda _: None,
) -> StudyRow:
    """Drive a study until it is finished, paused or cancelled.

    Args:
        database: URL of the trial database.
        artifact_root: where trials leave their files.
        name: the study, which exists.
        inline: run trials one after the other in this process, without Ray.
        pools: cores of each worker pool; default: one pool `default` with all cores of this machine, or the pools
            of the cluster at `ray_address`.
        take_over: fence off a living driver.
        ray_address: join this Ray cluster instead of starting a local one.
        tell: is told what people should know meanwhile.

    Returns:
        The study as it was released.

    Raises:
        InterruptedByUser: Ctrl-C or SIGTERM; the study is paused and resumable.
        StudyDriven: another driver holds it.
        TakenOver: another driver took it over meanwhile.
    """
    here = {"default": os.cpu_count() or 1}
    if inline:
        _drive_inline(database, artifact_root, name, dict(pools or here), take_over=take_over, tell=tell)
    else:
        sizes = pools or (here if ray_address is None else None)
        prepare(ray_address)
        from services.ray_running import drive_with_ray  # noqa: PLC0415 - Ray takes a second to import

        drive_with_ray(
            database,
            artifact_root,
            str(Path.cwd()),
            name,
            sizes,
            take_over=take_over,
            ray_address=ray_address,
            tell=tell,
        )
    store = open_store(database)
    try:
        row = store.study(name)
    finally:
        store.close()
    if row.state is StudyState.PAUSED and row.reason == INTERRUPTED:
        raise InterruptedByUser(f"Interrupted. Go on with: halma resume {name}")
    if row.driver is not None and lives(row.driver) is not False:
        raise TakenOver(
            f"Study {name} was taken over by {driving_words(row)}; this process has stopped driving it, and nothing "
            f"is lost. Follow it: halma watch {name}"
        )
    if row.driver is not None:
        raise HalmaError(f"Study {name}: its driver ended unexpectedly. Go on with: halma resume {name}")
    return row


def _drive_inline(
    database: str, artifact_root: str, name: str, sizes: dict[str, int], *, take_over: bool, tell: Tell
) -> None:
    store = open_store(database)
    artifacts = open_artifacts(artifact_root)
    coordinator = Coordinator(store, InlineDispatcher(artifacts, sizes), InlineStrategist(), tell=tell)
    try:
        with leaving_on_signals(lambda: coordinator.leave(StudyState.PAUSED, INTERRUPTED)):
            coordinator.take(name, take_over=take_over)
            coordinator.run()
    finally:
        coordinator.close()
        store.close()
