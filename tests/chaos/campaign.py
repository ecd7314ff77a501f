"""`make chaos`: hundreds of faults of all kinds on both databases, and the table of what came of them.

    make chaos [CHAOS="run --minutes 60 --results chaos.jsonl --seed 1"]
    make chaos CHAOS="run --only 'worker killed' --games 1"
    make chaos CHAOS="table --results chaos.jsonl"

Results are appended to a file; a run goes on where the last one at the same revision of the code ended, with what has
been had least, and ends when every kind has had its number of faults on every database that it makes sense on. Each
study has a seed of its own, which is printed and kept with its result; what a study that broke left behind is kept.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from arena import Arena, Shape, Undisturbed
from book import Book, revision, table
from forks import Forks
from host_games import HOST_KINDS, HostGame
from inline_games import Game, freeze, kill
from places import SmallDisk, server_on_small_disk
from postgres import running_server
from ray_faults import KINDS, Stuck
from ray_games import RayGame

CHAINS = {
    "killed before a commit (inline)": lambda game: game.chain("commit", "before", "kill", 12),
    "killed after a commit (inline)": lambda game: game.chain("commit", "after", "kill", 12),
    "killed before a file appears (inline)": lambda game: game.chain("rename", "before", "kill", 4),
    "killed after a file appeared (inline)": lambda game: game.chain("rename", "after", "kill", 4),
    "connection cut before a commit (inline)": lambda game: game.chain("commit", "before", "cut", 6),
    "connection cut after a commit (inline)": lambda game: game.chain("commit", "after", "cut", 6),
    "killed at any time (inline)": lambda game: game.at_any_time(kill, 0.4),
    "stopped at any time (inline)": lambda game: game.at_any_time(freeze, 0.4),
}
IN_TURN = {
    "killed before each commit in turn (inline)": ("commit", "before", "kill"),
    "killed after each commit in turn (inline)": ("commit", "after", "kill"),
    "killed before each file in turn (inline)": ("rename", "before", "kill"),
    "killed after each file in turn (inline)": ("rename", "after", "kill"),
    "connection cut before each commit in turn (inline)": ("commit", "before", "cut"),
    "connection cut after each commit in turn (inline)": ("commit", "after", "cut"),
}
ONLY_POSTGRES = ("database server restarted", "database connections cut")
ALONE = ("disk of artifacts full", "disk of database full", "clock jumps")
"""Kinds that have studies of their own: their places slow everything else down."""

DATABASES = ("SQLite", "PostgreSQL")
TINY = Shape(trials=3, iterations=2)
"""The study that every point is tried on in turn."""

GOALS = {"chains": 12, "in turn": 10**6, "Ray": 3, "hosts": 2}
"""Faults of each kind on each database; in turn: as many as there are points."""


@dataclass
class Group:
    """Kinds that one study can go through together.

    Args:
        kinds: of faults.
        database: on which.
        goals: faults wanted of each.
        play: the game, given the campaign, the group and a seed; gives results.
    """

    kinds: tuple
    database: str
    goals: dict
    play: object

    def covered(self, faults):
        """The part of what is wanted that has been had."""
        had = sum(min(faults[kind, self.database], goal) for kind, goal in self.goals.items())
        return had / sum(self.goals.values())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="break studies until there have been enough faults, or the time is over")
    running.add_argument("--minutes", type=float, default=120.0)
    running.add_argument("--games", type=int, default=10**6, help="at most so many studies")
    running.add_argument("--seed", type=int, default=int(time.time()))
    running.add_argument("--only", action="append", help="a kind of fault; may be given several times")
    running.add_argument("--on", choices=DATABASES, help="only on this database")
    running.add_argument("--times", type=float, default=1.0, help="so many times the usual number of faults")
    printing = commands.add_parser("table", help="print what is on file")
    printing.add_argument("--all-revisions", action="store_true", help="count the results of older code too")
    for each in (running, printing):
        each.add_argument("--results", type=Path, default=Path("chaos.jsonl"))
    options = parser.parse_args()
    if options.command == "table":
        print(printed(Book(options.results, None if options.all_revisions else revision())))
        return
    # Asked to end, it clears away as after Ctrl-C: no stopped process, server or mounted disk stays behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with Campaign(options) as campaign:
        good = campaign.run()
    print(printed(campaign.book))
    sys.exit(0 if good else 1)


def printed(book):
    """The table of a book."""
    return table(book.results(), [*IN_TURN, *CHAINS, *KINDS, *HOST_KINDS])


class Campaign:
    """Study after study until the goals are reached or the time is over."""

    def __init__(self, options):
        self.options, self.book = options, Book(options.results, revision())
        self._stack = contextlib.ExitStack()

    def __enter__(self):
        self.folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="halma-chaos-")))
        self.server = self._stack.enter_context(running_server())
        self.forks = Forks(self.folder)
        self._stack.callback(self.forks.close)
        self.undisturbed = Undisturbed(self.forks, self.folder / "undisturbed")
        return self

    def __exit__(self, *stopped):
        self._stack.__exit__(*stopped)

    def groups(self):
        """What can be played, and how much of it is wanted."""
        points = self.undisturbed.of(TINY)[1]
        for database in DATABASES if self.options.on is None else (self.options.on,):
            together = [kind for kind in KINDS if kind not in ALONE]
            if database == "SQLite":
                together = [kind for kind in together if kind not in ONLY_POSTGRES]
            sets = [
                *(((kind,), GOALS["chains"], Campaign.chain) for kind in CHAINS),
                *(((kind,), points.count(IN_TURN[kind][0]), Campaign.in_turn) for kind in IN_TURN),
                (together, GOALS["Ray"], Campaign.with_ray),
                *(((kind,), GOALS["Ray"], Campaign.with_ray) for kind in ALONE),
                (HOST_KINDS, GOALS["hosts"], Campaign.with_hosts),
            ]
            for kinds, goal, play in sets:
                wanted = tuple(kind for kind in kinds if not self.options.only or kind in self.options.only)
                if wanted:
                    yield Group(wanted, database, {kind: round(goal * self.options.times) for kind in wanted}, play)

    def run(self):
        """Whether every promise was kept."""
        end, good, groups = time.monotonic() + 60 * self.options.minutes, True, list(self.groups())
        fruitless = Counter()
        for number in range(self.options.games):
            faults = self.book.faults()
            # Faults that don't come to happen must not keep the others from their turn.
            group = min(groups, key=lambda each: each.covered(faults) + fruitless[id(each)])
            if group.covered(faults) >= 1 or time.monotonic() > end:
                break
            seed = self.options.seed + number
            folder = self.folder / str(seed)
            results = group.play(self, group, folder, seed)
            self.book.write(results)
            fruitless[id(group)] += not results
            good &= all(result["good"] for result in results)
            if not all(result["good"] for result in results):
                kept = self.options.results.with_suffix(".broken") / str(seed)
                shutil.copytree(folder, kept, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.so"))
            shutil.rmtree(folder, ignore_errors=True)
        return good

    def _server(self, group):
        return self.server if group.database == "PostgreSQL" else None

    # -- the games -------------------------------------------------------------------------------------------------

    def chain(self, group, folder, seed):
        """One study without Ray, fault upon fault."""
        rng, (kind,) = np.random.default_rng(seed), group.kinds
        shape = Shape(strategy=str(rng.choice(["tpe", "sobol", "random"])))
        game = Game(self.forks, Arena(folder, shape, self._server(group)), self.undisturbed.of(shape)[0], rng)
        verdict = CHAINS[kind](game)
        return told(seed, group, verdict, {kind: game.faults}, game.cost(kind))

    def in_turn(self, group, folder, seed):
        """A study without Ray for each of the next points, with one fault at this point."""
        (kind,), rng = group.kinds, np.random.default_rng(seed)
        expected, points = self.undisturbed.of(TINY)
        point, when, do = IN_TURN[kind]
        had = self.book.places()[kind, group.database]
        results = []
        for place in [place for place in range(1, points.count(point) + 1) if place not in had][:8]:
            game = Game(self.forks, Arena(folder / str(place), TINY, self._server(group)), expected, rng)
            verdict = game.at_point(point, when, do, place)
            verdict.expect(game.faults == 1, f"{game.faults} faults at point {place}")
            results += told(seed, group, verdict, {kind: game.faults}, game.cost(kind), place=place)
        return results

    def with_ray(self, group, folder, seed):
        """One study with Ray under many faults. Disks are small and clocks false only where that is the fault."""
        rng, kinds, places = np.random.default_rng(seed), list(group.kinds), {}
        with contextlib.ExitStack() as stack:
            server = self._server(group)
            if kinds == ["disk of artifacts full"]:
                places["artifacts"] = stack.enter_context(SmallDisk(folder / "disk", 8)) / "walk.artifacts"
            elif kinds == ["disk of database full"] and server is None:
                places["database"] = str(stack.enter_context(SmallDisk(folder / "disk", 8)) / "halma.db")
            elif kinds == ["disk of database full"]:
                server = stack.enter_context(server_on_small_disk(folder))
            shape, expected = self._shape(rng, trials=16, iterations=6)
            arena = Arena(folder, shape, server, leases=10, **places)
            if kinds == ["clock jumps"]:
                arena.false_clock()
            game = RayGame(arena, rng, expected, say=lambda what: say(seed, what))
            return self._played(game, group, seed, kinds, 4 if len(kinds) == 1 else 14)

    def with_hosts(self, group, folder, seed):
        """One study on three hosts."""
        rng = np.random.default_rng(seed)
        shape, expected = self._shape(rng, trials=16, iterations=12)
        say(seed, "hosts start")
        with HostGame(
            folder, shape, self._server(group), rng, expected=expected, say=lambda what: say(seed, what)
        ) as game:
            return self._played(game, group, seed, {kind: HOST_KINDS[kind] for kind in group.kinds}, 6)

    def _shape(self, rng, **size):
        """One trial at a time, which has to equal the undisturbed study; or two."""
        alone = bool(rng.random() < 0.5)
        shape = Shape(seconds=0.12, parallel=1 if alone else 2, **size)
        return shape, self.undisturbed.of(shape)[0] if alone else None

    def _played(self, game, group, seed, kinds, enough):
        faults = self.book.faults()
        try:
            verdict = game.play(kinds, enough, had={kind: faults[kind, group.database] for kind in kinds})
        except Stuck as trouble:
            game.clear_away()
            verdict = game.arena.judge()
            verdict.stuck = max(1, verdict.stuck)
            verdict.broken.append(str(trouble))
        except Exception:  # noqa: BLE001 - a fault of the harness is a result to look at, not the end of the night
            game.clear_away()
            verdict = game.arena.judge()
            verdict.broken.append(traceback.format_exc())
        return told(
            seed,
            group,
            verdict,
            game.faults,
            game.marks.count(game.arena.iterations(), game.arena.record().processes()),
        )


def told(seed, group, verdict, faults, cost, **more):
    """A result for each kind of fault; what is broken is put down to all kinds of the study."""
    say(seed, f"{group.database} {'kept' if verdict.good else 'BROKEN'}: {dict(faults)} {more or ''} {verdict.broken}")
    return [
        {
            "seed": seed,
            "kind": kind,
            "database": group.database,
            "faults": count,
            "lost": verdict.lost,
            "duplicated": verdict.duplicated,
            "stuck": verdict.stuck,
            "repeated": cost[kind].iterations if kind in cost else 0,
            "most": cost[kind].most if kind in cost else 0,
            "beside": cost[kind].beside if kind in cost else 0,
            "good": verdict.good,
            "broken": verdict.broken,
            **more,
        }
        for kind, count in faults.items()
        if count or not verdict.good
    ]


def say(seed, what):
    """To whoever watches."""
    print(f"{time.strftime('%H:%M:%S')} seed {seed}: {what}", flush=True)


if __name__ == "__main__":
    main()
