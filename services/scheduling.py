"""Who gets free cores, and who has to give some back.

Priorities are strict: a study of higher priority is served first, and where nothing is left for it, attempts of lower
ones are asked to stop at their next checkpoint. Among equals cores are shared in proportion to `share`, counted in
core-seconds: start-time fair queueing (Goyal, Vin and Cheng 1996, section 3) with a study as the flow and a trial as
the packet. A study's tag is the core-seconds it has had, over its share; the smallest is served next. One that begins,
or comes back, gets at least the smallest tag of those at work: nobody is owed for the time in which he wanted nothing.

Every decision is made from what the driver knows anyway, anew in each pass; only the tags are remembered, and a driver
that takes over begins them at zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from services.dispatch.hosts import best_fit, take_room
from services.dispatch.port import Dispatcher
from services.drive import Drive, Live

HORIZON = 60.0
"""Seconds for which a core that is being given counts in advance, so that equals share the pool at once, and not by
turns of a whole trial."""

STRANDED_SECONDS = 5.0
"""How long a pool may have no host for a study before that is said: hosts come and go."""

Rooms = dict[str, dict[str, float]]
"""Free cores by pool and host."""


@dataclass(slots=True)
class Scheduler:
    """Hands out the cores of a dispatcher's pools.

    Args:
        dispatcher: whose pools.
    """

    dispatcher: Dispatcher
    _tags: dict[int, float] = field(default_factory=dict)
    """Core-seconds over share, by study."""
    _queues: dict[int, tuple[str, int]] = field(default_factory=dict)
    """Pool and priority in which each study at work stands."""
    _held: dict[int, float] = field(default_factory=dict)
    """Core-seconds over share that each study has used up a second, since the last pass."""
    _charged: float | None = None
    _stranded: dict[int, float] = field(default_factory=dict)
    """Since when no host could run a trial of a study."""

    def charge(self, drives: Iterable[Drive], now: float) -> None:
        """Count the core-seconds since the last time, and let in who has begun to want something."""
        elapsed = 0.0 if self._charged is None else max(0.0, now - self._charged)
        self._charged = now
        drives = list(drives)
        for drive in drives:
            study = drive.row.id
            self._tags[study] = self._tags.get(study, 0.0) + self._held.get(study, 0.0) * elapsed
        before = self._queues
        self._queues = {
            drive.row.id: (drive.row.pool, drive.row.priority)
            for drive in drives
            if drive.live or drive.asked or (drive.leaving is None and drive.appetite(now) > 0)
        }
        at_work = [(study, queue) for study, queue in self._queues.items() if before.get(study) == queue]
        for study, queue in self._queues.items():
            if before.get(study) != queue:
                others = [self._tags[other] for other, theirs in at_work if theirs == queue]
                self._tags[study] = max(self._tags[study], min(others, default=0.0))
        known = {drive.row.id for drive in drives}
        self._tags = {study: tag for study, tag in self._tags.items() if study in known}

    def hold(self, drives: Iterable[Drive]) -> None:
        """What is held from now on, until the next pass: also by attempts that will have ended by then."""
        self._held = {drive.row.id: drive.cores / drive.spec.share for drive in drives}

    def hand_out(self, drives: Sequence[Drive], now: float) -> tuple[list[tuple[Drive, int]], Rooms]:
        """How many more trials each study may start or ask for, and what room is then left.

        A trial that is next and finds no host with room enough keeps the one where it would fit first: narrower ones
        behind it don't fill that host again and again before its eyes.
        """
        rooms = {pool: dict(self.dispatcher.rooms(pool)) for pool in {drive.row.pool for drive in drives}}
        for drive in drives:
            for _ in range(drive.asked.count if drive.asked else 0):
                take_room(rooms[drive.row.pool], drive.spec.resources.cpus)
        left = {pool: dict(hosts) for pool, hosts in rooms.items()}
        given = dict.fromkeys((drive.row.id for drive in drives), 0)
        hungry = [drive for drive in drives if drive.leaving is None and drive.appetite(now) > 0]
        while hungry:
            chosen = min(hungry, key=lambda drive: self._claim(drive, given[drive.row.id]))
            pool, cpus = chosen.row.pool, chosen.spec.resources.cpus
            host = best_fit(rooms[pool], cpus)
            if host is not None:
                rooms[pool][host] -= cpus
                left[pool][host] -= cpus
                given[chosen.row.id] += 1
                if given[chosen.row.id] < chosen.appetite(now):
                    continue
            else:
                self._keep_a_host(rooms[pool], pool, cpus)
            hungry.remove(chosen)
        return [(drive, given[drive.row.id]) for drive in drives if given[drive.row.id]], left

    def _claim(self, drive: Drive, given: int) -> tuple[int, float, int]:
        """Its place in the queue when it has been given so many slots: the smallest comes first."""
        coming = drive.cores + drive.reserved + given * drive.spec.resources.cpus
        return (
            -drive.row.priority,
            self._tags.get(drive.row.id, 0.0) + coming * HORIZON / drive.spec.share,
            drive.row.id,
        )

    def _keep_a_host(self, rooms: dict[str, float], pool: str, cpus: float) -> None:
        able = [(rooms.get(host, 0.0), host) for host, size in self.dispatcher.sizes(pool).items() if size >= cpus]
        if able:
            rooms.pop(max(able)[1], None)

    # -- giving back -----------------------------------------------------------------------------------------------

    def displaced(
        self, drives: Sequence[Drive], given: Mapping[int, int], left: Rooms, now: float
    ) -> list[tuple[Drive, Live, str]]:
        """Attempts that have to stop at their next checkpoint, with the reason: as few as will do.

        Args:
            drives: all studies, also those that are leaving.
            given: slots that `hand_out` has just given, by study.
            left: the room that it left.
            now: monotonic seconds.
        """
        stops: list[tuple[Drive, Live, str]] = [
            (drive, live, f"moved to pool {drive.row.pool}")
            for drive in drives
            if drive.leaving is None and self._fits(drive)
            for live in drive.live.values()
            if live.pool != drive.row.pool and not live.stopping
        ]
        chosen = {live.attempt for _, live, _ in stops}
        room = {pool: dict(hosts) for pool, hosts in left.items()}
        for drive in drives:
            for live in drive.live.values():
                if live.stopping or live.attempt in chosen:
                    self._give(room, live)
        waiting = [drive for drive in drives if drive.leaving is None]
        for drive in sorted(waiting, key=lambda drive: self._claim(drive, given.get(drive.row.id, 0))):
            unserved = drive.appetite(now) - given.get(drive.row.id, 0)
            while unserved > 0:
                victims = self._room_for(drive, drives, room.setdefault(drive.row.pool, {}), chosen)
                if victims is None:
                    break
                for other, live in victims:
                    chosen.add(live.attempt)
                    self._give(room, live)
                    stops.append((other, live, f"preempted by {drive.row.name} (priority {drive.row.priority})"))
                take_room(room[drive.row.pool], drive.spec.resources.cpus)
                unserved -= 1
        return stops

    def _give(self, room: Rooms, live: Live) -> None:
        """Count the cores of an attempt as free."""
        host = self.dispatcher.where(live.attempt)
        if host is not None:
            hosts = room.setdefault(live.pool, {})
            hosts[host] = hosts.get(host, 0.0) + live.cpus

    def _room_for(
        self, drive: Drive, drives: Sequence[Drive], room: Mapping[str, float], chosen: set[int]
    ) -> list[tuple[Drive, Live]] | None:
        """Attempts of lower priority that would have to stop for one more trial; None where that would not do.

        The lowest priority first, and of equals who began last: it has the least to lose.
        """
        cpus = drive.spec.resources.cpus
        if best_fit(room, cpus) is not None:
            return []
        by_host: dict[str, list[tuple[Drive, Live]]] = {}
        for other in drives:
            if other.row.priority < drive.row.priority:
                for live in other.live.values():
                    host = self.dispatcher.where(live.attempt)
                    may_stop = live.pool == drive.row.pool and not live.stopping and live.attempt not in chosen
                    if host is not None and may_stop:
                        by_host.setdefault(host, []).append((other, live))
        plans = []
        for host, candidates in by_host.items():
            free, plan = room.get(host, 0.0), list[tuple[Drive, Live]]()
            for other, live in sorted(candidates, key=_least_to_lose):
                if free >= cpus:
                    break
                free += live.cpus
                plan.append((other, live))
            if free >= cpus:
                plans.append((max(other.row.priority for other, _ in plan), len(plan), host, plan))
        return min(plans, key=lambda each: each[:3])[3] if plans else None

    # -- those that can't run --------------------------------------------------------------------------------------

    def _fits(self, drive: Drive) -> bool:
        """Whether any host, were it free, could run a trial of the study."""
        cpus = drive.spec.resources.cpus
        return any(size >= cpus for size in self.dispatcher.sizes(drive.row.pool).values())

    def stranded(self, drive: Drive, now: float) -> str:
        """Why no host can run a trial of the study, where that has been so for a while; else empty."""
        if self._fits(drive) or drive.leaving is not None or drive.finished():
            self._stranded.pop(drive.row.id, None)
            return ""
        if now - self._stranded.setdefault(drive.row.id, now) < STRANDED_SECONDS:
            return ""
        pool, cpus = drive.row.pool, drive.spec.resources.cpus
        sizes = self.dispatcher.sizes(pool)
        cores = f"{cpus:g} core{'' if cpus == 1 else 's'}"
        found = f"no host with more than {max(sizes.values()):g}" if sizes else "no host in it"
        pools = self.dispatcher.pools()
        others = ", ".join(f"{name} ({size})" for name, size in pools.items() if name != pool and size)
        return (
            f"waits for a host: expected one with {cores} in pool {pool}, found {found}; let one join, or change the "
            f"study: halma set {drive.row.name} pool=NAME cpus=N (other pools: {others or 'none'})"
        )


def _least_to_lose(candidate: tuple[Drive, Live]) -> tuple[int, float, int]:
    """Sorting key of attempts that might give way: the first one should."""
    drive, live = candidate
    return (drive.row.priority, -live.began, -live.attempt)
