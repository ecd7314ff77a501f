"""The repaired diversity search: embeddings, feasibility, no repetition, statistics against random search."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm
from search_cases import facing, history_of, jump_space

from search import Angle, Candidate, Features, Float, Observation, Space, make_strategy
from search.bds.default import INSETS, DiversityModel, fit_models
from search.record import read_record
from search.surrogate.embedding import Embedding
from search.surrogate.milestones import milestone
from search.surrogate.subset import farthest_first

METRICS = [Features.circle(), Features.rotation(), Features.euclidean(3, low=[0, -1, 2], high=[1, 4, 5])]


def behaviours(metric, count, seed):
    rng = np.random.default_rng(seed)
    if metric.kind == "rotation":
        return metric.canonical(rng.standard_normal((count, 4)))
    return rng.uniform(metric.low, metric.high, (count, metric.d))


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.kind)
@given(seed=st.integers(0, 2**32 - 1))
def test_embedded_distances_are_the_metrics_own(metric, seed):
    Y, known = behaviours(metric, 6, seed), behaviours(metric, 4, seed + 1)
    e = Embedding(metric)
    fast = e.nearest(e.embed(Y), e.embed(known))
    assert np.allclose(fast, metric.pairwise(Y, known).min(1), atol=1e-5)


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.kind)
@given(seed=st.integers(0, 2**32 - 1))
def test_embedding_and_back_is_the_identity(metric, seed):
    Y = behaviours(metric, 5, seed)
    e = Embedding(metric)
    assert metric.distance(e.unembed(e.embed(Y)), Y).max() < 1e-6


def test_q_and_minus_q_are_one_outcome():
    e = Embedding(Features.rotation())
    Y = behaviours(Features.rotation(), 5, 0)
    assert np.allclose(e.embed(Y), e.embed(-Y))


def model_of(space, metric, history, pending=()):
    record = read_record(space, metric, history, list(pending))
    return DiversityModel(space, metric, record, fit_models(space, metric, record), feasibility=True)


def test_expected_novelty_agrees_with_quadrature_in_one_dimension():
    space, metric = Space({"x": Float(0, 1)}), Features.euclidean(1, low=-1, high=1)
    history = [Observation(Candidate({"x": x}), 1.0, [y]) for x, y in ((0.1, -0.5), (0.5, 0.2), (0.9, 0.6))]
    model = model_of(space, metric, history)
    E = np.array([[0.3], [0.7]])
    mean, variance = model.behaviour.posterior(E)
    sigma = model.behaviour.amplitude[0] * np.sqrt(variance)
    fast = model.expected_novelty(E, np.random.default_rng(0).standard_normal((20000, 1)), math.inf, model.archive)
    for i in range(2):
        slow, _ = quad(
            lambda y, i=i: min(abs(y + 0.5), abs(y - 0.2), abs(y - 0.6)) * norm.pdf(y, mean[i, 0], sigma[i]),
            -4,
            4,
            limit=200,
        )
        assert fast[i] == pytest.approx(slow, rel=0.03)


def test_failures_lower_the_probability_of_success_around_them_and_nowhere_else():
    space, metric = Space({"x": Float(0, 1), "y": Float(0, 1)}), Features.circle()
    history = []
    for u in np.random.default_rng(0).random((30, 2)):
        params = space.from_unit(u)
        fails = params["x"] > 0.6
        history.append(
            Observation(
                Candidate(params), *((None, None) if fails else (1.0, [u[1]])), status="failed" if fails else "complete"
            )
        )
    model = model_of(space, metric, history)
    p = model.probability_feasible(space.encode(np.array([[0.9, 0.5], [0.2, 0.5]])))
    assert p[0] < 0.3
    assert p[1] > 0.8


def test_a_region_that_fails_is_left_alone():
    space = jump_space()
    strategy = make_strategy("bds", space, features=Features.circle())
    history = []
    for i in range(40):
        (c,) = strategy.propose(history, [], 1, np.random.default_rng(i))
        if c.params["omega_x"] > 0:
            history.append(Observation(c, status="failed"))
        else:
            history.append(Observation(c, 1.0, facing(c.params), 1.0))
    late = [o.status for o in history[20:]]
    assert late.count("failed") < 0.3 * len(late)


@settings(max_examples=20)
@given(st.lists(st.integers(-3, 3), min_size=8, max_size=8))
def test_turning_angles_by_full_turns_changes_no_proposal(turns):
    space = Space({"a": Angle(), "b": Float(0, 1)})
    strategy = make_strategy("bds", space, features=Features.circle())
    rng = np.random.default_rng(0)
    plain, turned = [], []
    for t in turns:
        params = space.from_unit(rng.random(2))
        y = params["a"] + params["b"]
        plain.append(Observation(Candidate(params), 1.0, [y]))
        further = {**params, "a": params["a"] + t * 2 * math.pi}
        turned.append(Observation(Candidate(further), 1.0, [y + t * 2 * math.pi]))
    (one,) = strategy.propose(plain, [], 1, np.random.default_rng(1))
    (other,) = strategy.propose(turned, [], 1, np.random.default_rng(1))
    gap = np.abs(space.to_unit(one.params) - space.to_unit(other.params))
    assert np.minimum(gap, 1 - gap).max() < 1e-6


def test_the_order_of_a_history_changes_the_posterior_by_rounding_alone():
    space, metric = jump_space(), Features.circle()
    history = history_of(space, 20, seed=3)
    shuffled = [history[i] for i in np.random.default_rng(0).permutation(20)]
    E = space.encode(np.random.default_rng(1).random((10, 3)))
    one, other = (model_of(space, metric, h) for h in (history, shuffled))
    assert np.allclose(one.behaviour.posterior(E)[0], other.behaviour.posterior(E)[0], atol=1e-3)
    assert np.allclose(one.probability_feasible(E), other.probability_feasible(E), atol=1e-3)


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.kind)
def test_a_batch_repeats_neither_itself_nor_what_is_pending(metric):
    space = jump_space()
    strategy = make_strategy("bds", space, features=metric)
    history = [
        Observation(Candidate(space.from_unit(u)), 1.0, y)
        for u, y in zip(np.random.default_rng(0).random((10, 3)), behaviours(metric, 10, 0).tolist(), strict=True)
    ]
    pending = strategy.propose(history, [], 2, np.random.default_rng(1))
    batch = strategy.propose(history, pending, 6, np.random.default_rng(2))
    E = space.encode(np.array([space.to_unit(c.params) for c in [*pending, *batch]]))
    gaps = np.linalg.norm(E[:, None] - E[None], axis=2)[np.triu_indices(8, 1)]
    assert gaps.min() > 0.1


def test_a_strategy_that_has_seen_other_histories_proposes_the_same():
    space = jump_space()
    used = make_strategy("bds", space, features=Features.circle())
    for n in (5, 30, 12):
        used.propose(history_of(space, n, seed=n), [], 1, np.random.default_rng(0))
    history = history_of(space, 40, seed=9)
    fresh = make_strategy("bds", space, features=Features.circle())
    assert used.propose(history, [], 2, np.random.default_rng(3)) == fresh.propose(
        history, [], 2, np.random.default_rng(3)
    )


def test_milestones_never_exceed_the_history_and_come_every_fifteen_per_cent():
    found = [milestone(n) for n in range(1, 2000)]
    assert all(m <= n for n, m in enumerate(found, 1))
    assert all(m >= n / 1.16 - 1 for n, m in enumerate(found, 1))
    assert found == sorted(found)


def test_farthest_first_is_greedy_and_keeps_small_sets_whole():
    X = np.array([[0.0], [0.1], [1.0], [0.55], [0.9]])
    assert farthest_first(X, 3).tolist() == [0, 2, 3]
    assert farthest_first(X, 9).tolist() == [0, 1, 2, 3, 4]


def bins_found(strategy, seed, evaluations=12):
    """Behaviour in eight classes; a third of the box fails, one class fills most of the rest."""
    space = Space({"a": Float(0, 1), "b": Float(0, 1), "c": Float(0, 1)})
    made = make_strategy(strategy, space, features=Features.circle())
    history, found = [], set()
    for i in range(evaluations):
        (c,) = made.propose(history, [], 1, np.random.default_rng((seed, i)))
        a, b, c_ = c.params["a"], c.params["b"], c.params["c"]
        if c_ > 0.67:
            history.append(Observation(c, status="failed"))
            continue
        t = 2 * a**3 - 2 * (1 - b) ** 3
        k = int(np.clip(np.floor((t + 2) * 2), 0, 7))
        found.add(k)
        history.append(Observation(c, 1.0, [(k + 0.5) / 8 * 2 * math.pi - math.pi], 1.0))
    return len(found)


@pytest.mark.slow
def test_more_distinct_behaviours_are_found_than_by_random_search():
    seeds = range(12)
    ours = np.array([bins_found("bds", s) for s in seeds])
    chance = np.array([bins_found("random", s) for s in seeds])
    gain = ours - chance
    assert gain.mean() > 2 * gain.std(ddof=1) / math.sqrt(len(gain))


def test_a_fit_that_breaks_falls_back_to_the_priors_and_says_so(monkeypatch):
    import search.surrogate.fit as module

    def broken(*arguments, **options):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(module, "minimize", broken)
    space = jump_space()
    (c,) = make_strategy("bds", space, features=Features.circle()).propose(
        history_of(space, 8, seed=0), [], 1, np.random.default_rng(0)
    )
    assert "surrogate not fitted, priors used: singular" in c.info["warnings"]


def test_distances_from_the_faces_take_turns():
    space = Space({"x": Float(0, 1), "y": Float(0, 1)})
    strategy = make_strategy("bds", space, features=Features.circle())
    gaps = {}
    for n in range(4, 10):
        history = [
            Observation(Candidate(space.from_unit(u)), 1.0, [6 * u[0] - 3])
            for u in np.random.default_rng(n).random((n, 2))
        ]
        (c,) = strategy.propose(history, [], 1, np.random.default_rng(n))
        u = space.to_unit(c.params)
        gaps.setdefault(c.info["inset"], []).append(float(np.minimum(u, 1 - u).min()))
    assert sorted(gaps) == sorted(INSETS)
    assert all(min(found) >= inset - 1e-9 for inset, found in gaps.items())
