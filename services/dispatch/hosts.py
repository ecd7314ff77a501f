"""The hosts of a cluster and their cores by pool: who has room, and where the next worker goes.

A pool is made of the cores that hosts give it: the Ray resource `pool:NAME` of a host says how many of its cores
belong to pool NAME, the rest belongs to the pool `default`. Hosts may come and go; pools follow.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

POOL_PREFIX = "pool:"
DEFAULT_POOL = "default"
LOOK_SECONDS = 1.0
PROBE_SECONDS = 1.0
"""How long a host that is in doubt may take to accept a connection."""


def pool_resource(pool: str) -> str:
    """Name of the Ray resource that gives cores of a host to a pool."""
    return f"{POOL_PREFIX}{pool}"


def cores_by_pool(resources: Mapping[str, float]) -> dict[str, float]:
    """Cores that one host gives to each pool, from its resources as Ray lists them."""
    pools = {name.removeprefix(POOL_PREFIX): cores for name, cores in resources.items() if name.startswith(POOL_PREFIX)}
    rest = resources.get("CPU", 0.0) - sum(pools.values())
    return {**pools, **({DEFAULT_POOL: rest} if rest > 0 else {})}


def best_fit(rooms: Mapping[str, float], cpus: float) -> str | None:
    """The host with the least room that suffices, so that wide trials find room where narrow ones leave it."""
    fitting = [(room, host) for host, room in rooms.items() if room >= cpus]
    return min(fitting)[1] if fitting else None


def take_room(rooms: dict[str, float], cpus: float) -> bool:
    """Take cores of the host where they fit best. Returns whether any host had them."""
    host = best_fit(rooms, cpus)
    if host is not None:
        rooms[host] -= cpus
    return host is not None


def _answers(node: Mapping[str, Any]) -> bool:
    """Whether the Ray process of a host accepts connections."""
    try:
        socket.create_connection((node["NodeManagerAddress"], node["NodeManagerPort"]), PROBE_SECONDS).close()
    except OSError:
        return False
    return True


@dataclass(slots=True)
class Hosts:
    """The hosts as last seen. Looking happens in a thread of its own: a cluster that doesn't answer stops nobody.

    Args:
        look: lists Ray's nodes (`ray.nodes`).
        caps: at most so many cores of each pool, and no other pools; None takes what the cluster has.
    """

    look: Callable[[], Iterable[Mapping[str, Any]]]
    caps: Mapping[str, int] | None
    _pools: dict[str, dict[str, float]] = field(default_factory=dict)
    _doubted: set[str] = field(default_factory=set)
    _ended: threading.Event = field(default_factory=threading.Event)

    def refresh(self) -> None:
        """Look now."""
        living = {str(node["NodeID"]): node for node in self.look() if node["Alive"]}
        # Ray takes ten seconds and more to see that a host is gone: what was sent there meanwhile would be lost.
        for host in list(self._doubted):
            if host not in living or _answers(living[host]):
                self._doubted.discard(host)
        doubted = set(self._doubted)
        self._pools = {
            host: cores_by_pool(node.get("Resources", {})) for host, node in living.items() if host not in doubted
        }

    def doubt(self, host: str) -> None:
        """A worker on this host vanished: send nothing there before it has answered."""
        self._doubted.add(host)
        self._pools = {other: pools for other, pools in self._pools.items() if other != host}

    def follow(self) -> None:
        """Keep looking until `close`."""
        threading.Thread(target=self._follow, name="hosts", daemon=True).start()

    def _follow(self) -> None:
        while not self._ended.wait(LOOK_SECONDS):
            # What was seen last is the best that is known; a head that is gone for good ends this process, too.
            with contextlib.suppress(Exception):
                self.refresh()

    def close(self) -> None:
        """Stop looking."""
        self._ended.set()

    def size(self, host: str, pool: str) -> float:
        """Cores that a host gives to a pool."""
        return self._pools.get(host, {}).get(pool, 0.0)

    def pools(self) -> dict[str, int]:
        """Names and sizes of the pools."""
        names = set(self.caps) if self.caps is not None else {pool for pools in self._pools.values() for pool in pools}
        totals = {name: sum(pools.get(name, 0.0) for pools in list(self._pools.values())) for name in names}
        return {name: int(min(total, self._cap(name))) for name, total in sorted(totals.items())}

    def _cap(self, pool: str) -> float:
        return float("inf") if self.caps is None else self.caps.get(pool, 0)

    def sizes(self, pool: str) -> dict[str, float]:
        """Cores that each host gives to a pool."""
        cap = self._cap(pool)
        found = {host: min(pools.get(pool, 0.0), cap) for host, pools in list(self._pools.items())}
        return {host: size for host, size in found.items() if size > 0}

    def rooms(self, pool: str, busy: Mapping[str, float]) -> dict[str, float]:
        """Free cores of a pool by host, when so many of its cores are busy on each."""
        left = self._cap(pool) - sum(busy.values())
        rooms: dict[str, float] = {}
        for host, pools in list(self._pools.items()):
            room = min(pools.get(pool, 0.0) - busy.get(host, 0.0), left)
            if room > 0:
                rooms[host] = room
                left -= room
        return rooms
