"""Algorithms 3 and 4 as printed: where, how hard, from which policy."""

import math

import numpy as np
import pytest

from search import Candidate, Float, Observation, Space, make_strategy
from search.quality import cmfbo_published as published
from search.quality.fidelity import ProductProcess
from search.record import read_record

LINE = Space({"x": Float(0, 1)})
BOX = Space({"x": Float(0, 1), "y": Float(0, 1)})


def process(points, values, noise=1e-6):
    XZ = np.array(points, dtype=float)
    return ProductProcess(XZ, np.array(values)[:, None], np.array([3.0, 1.0]), np.ones(1), noise, np.zeros(1))


def record_of(points, values):
    return read_record(
        LINE,
        None,
        [Observation(Candidate({"x": x}, z=z), value=v, cost=1.0) for (x, z), v in zip(points, values, strict=True)],
        [],
    )


def test_x_climbs_the_upper_confidence_bound_at_full_difficulty_from_the_best_evaluation():
    points, values = [(0.3, 1.0), (0.55, 1.0), (0.9, 0.2)], [0.2, 1.0, -0.5]
    gp, t = process(points, values), 3
    u = published._where(gp, LINE, record_of(points, values), t, np.random.default_rng(0))
    grid = np.linspace(0, 1, 4001)
    mean, variance = gp.posterior(np.column_stack([grid, np.ones(4001)]))
    # beta_t = 0.2 d log(2 t), the hand-worked bound on a dense grid
    ucb = mean[:, 0] + math.sqrt(0.2 * 1 * math.log(2 * t + 1)) * np.sqrt(variance)
    peaks = grid[1:-1][(ucb[1:-1] >= ucb[:-2]) & (ucb[1:-1] >= ucb[2:])]
    faces = [x for x, inner in ((0.0, 1), (1.0, -2)) if ucb[int(x * 4000)] > ucb[inner]]
    assert np.abs(np.array([*peaks, *faces]) - u[0]).min() < 1e-3
    here = np.interp(u[0], grid, ucb)
    assert here > np.interp(0.55, grid, ucb)


def test_the_difficulty_is_the_lowest_whose_predictive_deviation_is_above_two_hundredths():
    space = LINE
    made = make_strategy("cmfbo", space, settings={"variant": "published", "start": 1})
    history = [
        Observation(Candidate({"x": float(x)}, z=z), value=math.sin(5 * x) * (1.4 - 0.4 * z), cost=z)
        for x in np.random.default_rng(0).random(14)
        for z in (0.1, 0.2, 1.0)
    ]
    (c,) = made.propose(history, [], 1, np.random.default_rng(1))
    model = published.make_model(read_record(space, None, history, []))
    u = space.to_unit(c.params)
    at = np.column_stack([np.tile(u, (10, 1)), np.arange(1, 11) / 10])
    deviation = model.spread * model.gp.amplitude[0] * np.sqrt(model.gp.posterior(at)[1] + model.gp.noise[0])
    below = [z for z, s in zip(at[:, 1], deviation, strict=True) if s > 0.02]
    assert c.z == pytest.approx(below[0] if below else 1.0)


def test_an_easy_evaluation_that_says_nothing_new_is_followed_by_a_harder_one():
    made = make_strategy("cmfbo", BOX, settings={"variant": "published", "cost_budget": 12.0})
    history, seen = [], []
    for i in range(25):
        found = made.propose(history, [], 1, np.random.default_rng(i))
        for c in found:
            p = c.params
            value = (1.5 - 0.5 * c.z) * math.exp(-((p["x"] - 0.7) ** 2 + (p["y"] - 0.2) ** 2) / 0.2)
            history.append(Observation(c, value=value, cost=0.1 + 0.9 * c.z))
            seen.append(c.z)
    assert seen[:3] == [0.1, 0.1, 0.1]
    assert max(seen) > 0.1


def test_the_start_leaves_gradients_to_climb():
    # with one starting point all gradients in x vanish there, and every proposal is the first one again
    made = make_strategy("cmfbo", BOX, settings={"variant": "published"})
    history = []
    for i in range(9):
        (c,) = made.propose(history, [], 1, np.random.default_rng(i))
        p = c.params
        value = (1.5 - 0.5 * c.z) * math.exp(-((p["x"] - 0.7) ** 2 + (p["y"] - 0.2) ** 2) / 0.2)
        history.append(Observation(c, value=value, cost=0.1 + 0.9 * c.z))
    asked = {(round(o.candidate.params["x"], 6), round(o.candidate.params["y"], 6)) for o in history}
    assert len(asked) >= 6


def test_a_policy_comes_from_the_evaluation_of_highest_kernel_correlation():
    history = [
        Observation(Candidate({"x": x, "y": 0.5}, z=z), value=v, cost=1.0)
        for x, z, v in ((0.1, 0.1, 0.3), (0.5, 0.1, 1.0), (0.9, 0.1, 0.2), (0.6, 0.2, 0.9))
    ]
    made = make_strategy("cmfbo", BOX, settings={"variant": "published", "start": 1})
    (c,) = made.propose(history, [], 1, np.random.default_rng(0))
    gp = published.make_model(read_record(BOX, None, history, [])).gp
    here = np.append(BOX.to_unit(c.params), c.z)

    def matern(r):
        return (1 + math.sqrt(5) * r + 5 * r * r / 3) * math.exp(-math.sqrt(5) * r)

    def correlation(o):
        there = np.append(BOX.to_unit(o.candidate.params), o.candidate.z)
        gap = (here - there) * gp.w
        return matern(float(np.linalg.norm(gap[:2]))) * matern(abs(float(gap[2])))

    assert c.warm_start == max(range(4), key=lambda i: correlation(history[i]))


def test_a_fit_that_breaks_falls_back_and_says_so(monkeypatch):
    def broken(X, z, y):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(published, "_fit_botorch", broken)
    history = [Observation(Candidate({"x": x, "y": 0.5}, z=0.1), value=x, cost=0.2) for x in (0.1, 0.4, 0.7)]
    made = make_strategy("cmfbo", BOX, settings={"variant": "published"})
    (c,) = made.propose(history, [], 1, np.random.default_rng(0))
    assert c.info["warnings"] == ["fit failed: singular"]
