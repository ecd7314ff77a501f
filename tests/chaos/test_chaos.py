"""The short version of `make chaos`: a study goes through many faults and is what it would have been without them.

A failing case can be repeated: each has its own seed, and everything else follows from it.
"""

import subprocess
import time

import numpy as np
import pytest
from arena import Arena, Shape
from forks import Forks
from host_games import HOST_KINDS, HostGame
from inline_games import Game, freeze, kill
from lacking import without
from places import FalseClock, SmallDisk, fill_disk
from ray_games import RayGame

SHAPE = Shape()
POINTS = [
    ("commit", "before", "kill", 12),
    ("commit", "after", "kill", 12),
    ("rename", "before", "kill", 4),
    ("rename", "after", "kill", 4),
    ("commit", "before", "cut", 6),
    ("commit", "after", "cut", 6),
]


@pytest.fixture
def game(forks, undisturbed, server, tmp_path):
    return Game(forks, Arena(tmp_path, SHAPE, server), undisturbed.of(SHAPE)[0], np.random.default_rng(11))


def kept(game, verdict, at_least):
    """The promise was kept, after so many faults."""
    assert verdict.good, (verdict, game.arena.said())
    assert game.faults >= at_least


@pytest.mark.parametrize(("point", "when", "do", "reach"), POINTS, ids=str)
def test_a_study_disturbed_at_exact_points_equals_an_undisturbed_one(game, point, when, do, reach):
    kept(game, game.chain(point, when, do, reach), at_least=4)


def test_a_study_killed_at_any_time_equals_an_undisturbed_one(game):
    kept(game, game.at_any_time(kill, longest=0.3), at_least=2)


def test_a_study_that_is_stopped_and_goes_on_equals_an_undisturbed_one(game):
    kept(game, game.at_any_time(freeze, longest=0.3), at_least=1)


def test_a_study_killed_at_each_commit_in_turn_equals_an_undisturbed_one(forks, undisturbed, tmp_path):
    shape = Shape(trials=1, iterations=2)
    expected, points = undisturbed.of(shape)
    assert points.count("commit") > 5
    for place in range(1, points.count("commit") + 1):
        when = ("before", "after")[place % 2]
        game = Game(forks, Arena(tmp_path / str(place), shape), expected, np.random.default_rng(place))
        kept(game, game.at_point("commit", when, "kill", place), at_least=1)


def test_a_study_whose_clock_jumps_equals_an_undisturbed_one(undisturbed, tmp_path):
    clock, days = FalseClock(tmp_path), iter([1, -1, 30, -30] * 50)

    def jump(pid):
        """To and fro while it runs; it is killed after the second jump, so that another process meets the third."""
        clock.set(86400 * next(days))
        time.sleep(0.05)
        clock.set(86400 * next(days))
        return kill(pid)

    jumping = Forks(tmp_path, **clock.environment)
    try:
        game = Game(jumping, Arena(tmp_path / "arena", SHAPE), undisturbed.of(SHAPE)[0], np.random.default_rng(4))
        kept(game, game.at_any_time(jump, longest=0.1), at_least=2)
    finally:
        jumping.close()
    days_seen = {row["started_at"][:10] for row in game.arena.record().attempts}
    assert len(days_seen) > 1, "the jumps of the clock were not seen"


def may(*command):
    """Whether the kernel lets us: these tests make file systems and networks of their own."""
    done = subprocess.run(["unshare", *command, "true"], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        without(f"expected root, who may {' '.join(command)}; found: {done.stderr.strip()}")


@pytest.mark.parametrize("full", ["artifacts", "database"])
def test_a_study_whose_disk_was_full_equals_an_undisturbed_one(full, forks, undisturbed, tmp_path):
    may("--mount")
    with SmallDisk(tmp_path / "disk", 8) as disk:
        places = {"artifacts": disk / "walk.artifacts"} if full == "artifacts" else {"database": str(disk / "halma.db")}
        arena = Arena(tmp_path / "arena", SHAPE, **places)
        game = Game(forks, arena, undisturbed.of(SHAPE)[0], np.random.default_rng(6))
        kept(game, game.at_any_time(lambda _: fill_disk(disk, 0.5) is None, longest=0.2), at_least=1)


@pytest.mark.ray
@pytest.mark.slow
def test_a_study_on_three_hosts_goes_on_when_one_is_killed_another_joins_and_the_network_is_cut(undisturbed, tmp_path):
    may("--mount", "--net", "--pid", "--uts", "--fork")
    shape = Shape(trials=6, iterations=8, seconds=0.12)
    kinds = {
        kind: HOST_KINDS[kind]
        for kind in ("worker host killed, another joins (hosts)", "network cut for a moment (hosts)")
    }
    with HostGame(tmp_path, shape, None, np.random.default_rng(2), expected=undisturbed.of(shape)[0]) as game:
        verdict = game.play(kinds, enough=3)
    assert verdict.good, (verdict, game.faults, game.arena.said())
    assert sum(game.faults.values()) >= 2, game.faults


@pytest.mark.ray
@pytest.mark.slow
def test_a_study_outlives_its_processes_killed_and_stopped_in_any_order(server, undisturbed, tmp_path):
    kinds = [
        "worker killed", "worker killed before a file appears", "worker stopped for a moment", "strategy killed",
        "coordinator killed after a commit", "checkpoint torn", "driver killed",
    ]  # fmt: skip
    if server is not None:
        kinds += ["database server restarted", "database connections cut"]
    shape = Shape(trials=8, iterations=5, seconds=0.1)
    arena = Arena(tmp_path, shape, server, leases=10)
    game = RayGame(arena, np.random.default_rng(3), expected=undisturbed.of(shape)[0])
    verdict = game.play(kinds, enough=8)
    assert verdict.good, (verdict, game.faults, arena.said())
    assert sum(game.faults.values()) >= 5, game.faults
