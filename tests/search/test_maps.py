"""The synthetic strategy maps that searches are measured on."""

import numpy as np
import pytest

from benchmarks.search.map_sets import FLIGHTS, REPORT, VALIDATE, WIDE
from benchmarks.search.maps import World, world


@pytest.mark.parametrize("m", [*REPORT, *FLIGHTS, *VALIDATE, *WIDE], ids=lambda m: m.name)
def test_every_strategy_of_a_map_can_be_reached_and_failures_have_their_share(m):
    w = world(m)
    labels = w.labels(w.sample)
    assert set(labels[labels >= 0].tolist()) == set(range(m.count))
    assert np.mean(labels < 0) == pytest.approx(m.fails, abs=0.02)


@pytest.mark.parametrize("m", [*REPORT, *FLIGHTS], ids=lambda m: m.name)
def test_without_noise_most_behaviours_lie_nearest_to_their_own_strategy(m):
    w = world(m)
    rng = np.random.default_rng(0)
    U = w.sample[:200]
    labels = w.labels(U)
    right = []
    for u, label in zip(U[labels >= 0], labels[labels >= 0], strict=True):
        y = m.features.check(w.behaviour(u, int(label), rng))
        right.append(int(np.argmin(m.features.pairwise(y[None, :], w.attractors)[0])) == label)
    assert np.mean(right) > 0.9


def test_a_world_is_drawn_from_its_name_alone():
    m = REPORT[0]
    one, other = World(m, 256), World(m, 256)
    assert np.array_equal(one.labels(one.sample), other.labels(other.sample))
