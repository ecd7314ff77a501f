"""The short version of `make chaos`: a study goes through many faults and is what it would have been without them.

A failing case can be repeated: each has its own seed, and everything else follows from it.
"""

import numpy as np
import pytest
from arena import Arena, Shape
from inline_games import Game, freeze, kill
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
    # Each interrupted training repeats at most the iteration it was in.
    assert verdict.repeated <= game.faults, verdict


@pytest.mark.parametrize(("point", "when", "do", "reach"), POINTS, ids=str)
def test_a_study_disturbed_at_exact_points_equals_an_undisturbed_one(game, point, when, do, reach):
    kept(game, game.chain(point, when, do, reach), at_least=4)


def test_a_study_killed_at_any_time_equals_an_undisturbed_one(game):
    kept(game, game.at_any_time(kill, longest=0.3), at_least=2)


def test_a_study_that_is_stopped_and_goes_on_equals_an_undisturbed_one(game):
    kept(game, game.at_any_time(freeze, longest=0.3), at_least=1)


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
