"""`make chaos`: hundreds of faults of all kinds on both databases, and the table of what came of them.

    make chaos [CHAOS="--minutes 60 --only KIND --seed 1 --results chaos.jsonl"]
    make chaos CHAOS=--table

Each study gets a seed of its own, which is printed and kept with its result; `--seed N --games 1` repeats it. Results
are appended, so several sittings add up; the table counts those of the newest revision only, unless told otherwise.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from pathlib import Path

import numpy as np
from arena import ROOT, Arena, Shape, Undisturbed
from forks import Forks
from inline_games import Game, freeze, kill
from postgres import running_server
from ray_games import KINDS, RayGame, SmallDisk, Stuck

INLINE = {
    f"{words} (inline)": move
    for words, move in {
        "killed before a commit": lambda game: game.chain("commit", "before", "kill", 12),
        "killed after a commit": lambda game: game.chain("commit", "after", "kill", 12),
        "killed before a file appears": lambda game: game.chain("rename", "before", "kill", 4),
        "killed after a file appeared": lambda game: game.chain("rename", "after", "kill", 4),
        "connection cut before a commit": lambda game: game.chain("commit", "before", "cut", 6),
        "connection cut after a commit": lambda game: game.chain("commit", "after", "cut", 6),
        "killed at any time": lambda game: game.at_any_time(kill, 0.4),
        "stopped at any time": lambda game: game.at_any_time(freeze, 0.4),
    }.items()
}
ONLY_POSTGRES = ("database server restarted", "database connections cut")
NEED_DISK = {"disk of artifacts full": "artifacts", "disk of database full": "database"}
NEED_CLOCK = ("clock jumps",)
PRINTED = ("faults", "lost", "duplicated", "stuck", "repeated")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("chaos.jsonl"))
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--games", type=int, default=10**6, help="at most so many studies")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", action="append", help="a kind of fault; may be given several times")
    parser.add_argument("--table", action="store_true", help="print the table of what is on file, and nothing else")
    parser.add_argument("--all-revisions", action="store_true", help="count the results of older code too")
    options = parser.parse_args()
    if not options.table:
        # Asked to end, it clears away as after Ctrl-C: no stopped process, server or mounted disk stays behind.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
        sys.exit(campaign(options))
    print(table(read(options.results, every=options.all_revisions)))


def campaign(options):
    """Study after study until the time is over; the number of broken promises."""
    end, broken = time.monotonic() + 60 * options.minutes, 0
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="halma-chaos-")))
        server = stack.enter_context(running_server())
        forks = Forks(folder)
        stack.callback(forks.close)
        undisturbed = Undisturbed(forks, folder / "undisturbed")
        for number in range(options.games):
            if time.monotonic() > end:
                break
            seed = options.seed + number
            results = one_game(forks, undisturbed, folder / str(seed), server, seed, options.only)
            with options.results.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps({"revision": revision(), **result}) + "\n" for result in results)
            broken += sum(not result["good"] for result in results)
    print(table(read(options.results, every=options.all_revisions)))
    return min(broken, 1)


def one_game(forks, undisturbed, folder, server, seed, only):
    """One study under faults that its seed chooses; a result for each kind."""
    rng = np.random.default_rng(seed)
    kinds = [kind for kind in [*INLINE, *KINDS] if not only or kind in only]
    inline = [kind for kind in kinds if kind in INLINE]
    with_ray = [kind for kind in kinds if kind in KINDS]
    postgres = server if rng.random() < 0.5 else None
    if not inline or (with_ray and rng.random() < 0.6):
        return ray_game(undisturbed, folder, postgres, rng, seed, with_ray)
    kind = str(rng.choice(inline))
    shape = Shape(strategy=str(rng.choice(["tpe", "sobol", "random"])))
    game = Game(forks, Arena(folder, shape, postgres), undisturbed.of(shape)[0], rng)
    verdict = INLINE[kind](game)
    return told(seed, postgres, verdict, {kind: game.faults}, {kind: verdict.repeated})


def ray_game(undisturbed, folder, postgres, rng, seed, kinds):
    """One study with Ray. Disks are small and clocks false only where that is the fault: both slow everything down."""
    fits = [kind for kind in kinds if postgres is not None or kind not in ONLY_POSTGRES]
    special = [kind for kind in fits if kind in NEED_DISK or kind in NEED_CLOCK]
    usual = [kind for kind in fits if kind not in special]
    places = {}
    with contextlib.ExitStack() as stack:
        if special and (not usual or rng.random() < 0.25):
            kind = str(rng.choice(special))
            if NEED_DISK.get(kind) == "database" and postgres is not None:
                postgres = None  # a full disk of the server's is its own business
            fits = [kind]
            if kind in NEED_DISK:
                disk = stack.enter_context(SmallDisk(folder / "disk", 8))
                places = (
                    {"artifacts": disk / "walk.artifacts"}
                    if NEED_DISK[kind] == "artifacts"
                    else {"database": str(disk / "halma.db")}
                )
        else:
            fits = usual
        alone = bool(rng.random() < 0.5)
        shape = Shape(trials=16, iterations=6, seconds=0.12, parallel=1 if alone else 2)
        arena = Arena(folder, shape, None if places.get("database") else postgres, leases=10, **places)
        if fits[0] in NEED_CLOCK:
            arena.false_clock()
        game = RayGame(arena, rng, undisturbed.of(shape)[0] if alone else None, say=lambda what: say(seed, what))
        try:
            verdict = game.play(fits, enough=14)
        except Stuck as trouble:
            game.clear_away()
            verdict = arena.judge()
            verdict.stuck = max(1, verdict.stuck)
            verdict.broken.append(str(trouble))
        except Exception:  # noqa: BLE001 - a fault of the harness is a result to look at, not the end of the night
            game.clear_away()
            verdict = arena.judge()
            verdict.broken.append(traceback.format_exc())
        return told(seed, arena.postgres, verdict, game.faults, game.repeated)


def told(seed, postgres, verdict, faults, repeated):
    """A result for each kind of fault; what is broken is put down to all kinds of the study."""
    results = [
        {
            "seed": seed,
            "kind": kind,
            "database": "SQLite" if postgres is None else "PostgreSQL",
            "faults": count,
            "lost": verdict.lost,
            "duplicated": verdict.duplicated,
            "stuck": verdict.stuck,
            "repeated": repeated.get(kind, 0),
            "good": verdict.good,
            "broken": verdict.broken,
        }
        for kind, count in faults.items()
        if count or not verdict.good
    ]
    say(seed, f"{'kept' if verdict.good else 'BROKEN'}: {dict(faults)} {'' if verdict.good else verdict.broken}")
    return results


def say(seed, what):
    print(f"{time.strftime('%H:%M:%S')} seed {seed}: {what}", flush=True)


def revision():
    """The newest commit of the code under test."""
    of_code = ["git", "log", "-1", "--format=%h", "--", "services", "search", "workers"]
    done = subprocess.run(of_code, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout.strip()


def read(path, *, every):
    """Results on file; of the newest revision only, unless `every`."""
    results = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    return [result for result in results if every or result["revision"] == results[-1]["revision"]]


def table(results):
    """What came of each kind of fault, as Markdown."""
    sums = defaultdict(lambda: dict.fromkeys(PRINTED, 0))
    for result in results:
        for key in ((result["kind"], result["database"]), ("all", result["database"]), ("all", "both")):
            for name in PRINTED:
                sums[key][name] += result[name]
    order = {kind: place for place, kind in enumerate([*INLINE, *KINDS, "all"])}
    lines = [f"| kind | database | {' | '.join(PRINTED)} |", f"| --- | --- |{' --- |' * len(PRINTED)}"]
    for (kind, database), row in sorted(sums.items(), key=lambda item: (order[item[0][0]], item[0][1])):
        lines.append(f"| {kind} | {database} | {' | '.join(str(row[name]) for name in PRINTED)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
