"""The coordinator and the strategies as Ray actors, and the local Ray they run on."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from services.artifacts.open import open_artifacts
from services.coordinator import Coordinator
from services.dispatch.hosts import Hosts, pool_resource
from services.dispatch.ray_workers import RayDispatcher
from services.errors import BadInput, HalmaError
from services.proposing import (
    ProposalRequest,
    Proposed,
    Proposer,
    decode_proposed,
    decode_request,
    encode_proposed,
    encode_request,
)
from services.states import StudyState
from services.store.open import open_store
from services.store.port import JSON

Actor = Any
"""A handle on an actor: what may be called on it is known to whoever made it."""


STARTS = 3
"""Ray gives its own processes 30 s to come up, which a machine under load can miss."""


class StrategyActor:
    """One study's strategy, in a process of its own: a slow model fit never delays a dispatch."""

    def __init__(self, spec: Mapping[str, JSON]) -> None:
        self._proposer = Proposer(spec)

    def propose(self, text: str) -> str:
        """The answer to a request, both as JSON text."""
        return encode_proposed(self._proposer.propose(decode_request(text)))


def start_strategy(spec: Mapping[str, JSON]) -> Actor:
    """A strategy actor. It takes no core: it works while the trainings wait for it, and rests while they run."""
    shaped: Actor = ray.remote(StrategyActor)
    return shaped.options(num_cpus=0, max_restarts=0, scheduling_strategy=_here()).remote(dict(spec))


def this_host() -> str:
    """Ray's name of the host that this process runs on."""
    return str(ray.get_runtime_context().get_node_id())


def _here() -> NodeAffinitySchedulingStrategy:
    """On this host: the trial database, the artifacts and people's own modules are where the driver was started."""
    return NodeAffinitySchedulingStrategy(this_host(), soft=False)


@dataclass(slots=True)
class RayStrategist:
    """The `services.proposing.Strategist` with an actor a study.

    Args:
        dispatcher: woken when an answer is ready.
    """

    dispatcher: RayDispatcher
    _actors: dict[int, Actor] = field(default_factory=dict)
    _specs: dict[int, Mapping[str, JSON]] = field(default_factory=dict)
    _ready: list[Proposed] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def open(self, study: int, spec: Mapping[str, JSON]) -> None:
        self._specs[study] = spec
        self._actors[study] = start_strategy(spec)

    def ask(self, request: ProposalRequest) -> None:
        reference = self._actors[request.study].propose.remote(encode_request(request))
        reference.future().add_done_callback(lambda future: self._answered(request, future))

    def _answered(self, request: ProposalRequest, future: Future[str]) -> None:
        error = future.exception()
        if error is None:
            answer = decode_proposed(future.result())
        elif isinstance(error, ray.exceptions.RayActorError):
            # The process was lost, not the strategy: a new one is told the record from its beginning.
            self._actors[request.study] = start_strategy(self._specs[request.study])
            answer = Proposed(request.study, missing_from=0)
        else:
            cause = error.cause if isinstance(error, ray.exceptions.RayTaskError) else error
            answer = Proposed(request.study, error=f"{type(cause).__name__}: {cause}")
        with self._lock:
            self._ready.append(answer)
        self.dispatcher.wake()

    def answers(self) -> list[Proposed]:
        with self._lock:
            ready, self._ready = self._ready, []
        return ready

    def close(self, study: int) -> None:
        self._specs.pop(study, None)
        actor = self._actors.pop(study, None)
        if actor is not None:
            ray.kill(actor)


class CoordinatorActor:
    """The coordinator in a process of its own.

    Args:
        database: URL of the trial database.
        artifact_root: where trials leave their files.
        directory: the submitter's working directory.
        pools: at most so many cores of each pool; None takes what the cluster has.
    """

    def __init__(self, database: str, artifact_root: str, directory: str, pools: dict[str, int] | None) -> None:
        self._store = open_store(database)
        mailbox = ray.get_runtime_context().current_actor
        hosts = Hosts(ray.nodes, pools)
        hosts.refresh()
        hosts.follow()
        self._dispatcher = RayDispatcher(
            artifact_root, open_artifacts(artifact_root).mark(), directory, hosts, this_host(), mailbox
        )
        self._coordinator = Coordinator(self._store, self._dispatcher, RayStrategist(self._dispatcher))

    # A group of one thread: messages of one worker must not overtake each other.
    @ray.method(concurrency_group="mail")
    def receive(self, texts: Sequence[str]) -> None:
        """Messages from a worker, in order."""
        self._dispatcher.put(texts)

    @ray.method(concurrency_group="control")
    def leave(self, state: str, reason: str) -> None:
        """Stop at the next checkpoints and release every study in this state."""
        self._coordinator.leave(StudyState(state), reason)
        self._dispatcher.wake()

    @ray.method(concurrency_group="control")
    def trouble(self) -> str:
        """Why nothing can be recorded now; empty where it can."""
        return self._coordinator.trouble()

    @ray.method(concurrency_group="control")
    def pid(self) -> int:
        """The process id, once it is up."""
        return os.getpid()

    def drive(self, name: str, *, take_over: bool) -> None:
        """Drive one study until it is released."""
        try:
            self._coordinator.take(name, take_over=take_over)
            self._coordinator.run()
        finally:
            self._coordinator.close()

    def serve(self) -> None:
        """Drive every study that is submitted, until asked to leave."""
        try:
            self._coordinator.serve()
        finally:
            self._coordinator.close()


def start_coordinator(database: str, artifact_root: str, directory: str, pools: Mapping[str, int] | None) -> Actor:
    """A coordinator actor (see `CoordinatorActor`), not driving anything yet."""
    remote: Any = ray.remote  # its overloads don't know of concurrency groups
    # `mail` has one thread, so that messages of one worker can't overtake each other.
    actor = remote(
        num_cpus=0, max_restarts=0, concurrency_groups={"mail": 1, "control": 2}, scheduling_strategy=_here()
    )(CoordinatorActor)
    return actor.remote(database, artifact_root, directory, None if pools is None else dict(pools))


def start_ray(pools: Mapping[str, int] | None, address: str | None = None) -> None:
    """Start a local Ray with room for these pools, or join the cluster at `address`.

    Ray's own dashboard and usage reports stay off; a local Ray's processes end with this one.

    Raises:
        BadInput: no cluster answers at the address, or it doesn't let us in.
        HalmaError: the local Ray did not start.
    """
    handler = signal.getsignal(signal.SIGTERM)
    if address is not None:
        _join(address)
    else:
        _start_local(pools or {})
    # Ray takes SIGTERM for itself and exits with its number; whoever starts Ray here has plans of its own for it.
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)


def _join(address: str) -> None:
    if address.startswith("ray://"):
        raise BadInput(
            f"--ray-address {address}: expected a cluster that this host belongs to, found an address of Ray's client; "
            "run `ray start --address=HEAD:6379` here and give HEAD:6379, or `auto`"
        )
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        ray.shutdown()
        found = " ".join(str(error).split()) or type(error).__name__
        raise BadInput(
            f"--ray-address {address}: expected a Ray cluster that this host belongs to, found: {found}; "
            "start one with `ray start --head`, join it with `ray start --address=HEAD:6379`, and give all hosts the "
            "same token (RAY_AUTH_TOKEN, or ~/.ray/auth_token)"
        ) from error


def _start_local(pools: Mapping[str, int]) -> None:
    resources = {pool_resource(pool): float(size) for pool, size in pools.items() if pool != "default"}
    for tries_left in reversed(range(STARTS)):
        try:
            ray.init(
                address="local",  # else it joins whatever cluster was last started on this machine
                num_cpus=max(1, sum(pools.values())),
                num_gpus=0,
                resources=resources,
                include_dashboard=False,
                logging_level=logging.ERROR,
                log_to_driver=False,
                configure_logging=False,
            )
        except Exception as error:
            ray.shutdown()
            if not tries_left:
                raise HalmaError(
                    f"Ray did not start in {STARTS} tries: {error} If the machine is busy, try again later; "
                    "`halma run --inline` works without Ray."
                ) from error
        else:
            return


def stop_ray() -> None:
    """End Ray and its processes."""
    ray.shutdown()
