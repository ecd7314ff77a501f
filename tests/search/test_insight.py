"""Slices and importances, on functions whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from search import Angle, Candidate, Categorical, Features, Float, Int, Observation, Space, make_strategy
from search.errors import BadParams
from search.insight.importance import importances, narrowed
from search.insight.slices import LARGEST_GRID, Ask, NothingYet, axis, slice_of
from search.insight.surrogates import Surrogates
from search.record import read_record

SIX = Space({f"x{i}": Float(0.0, 1.0) for i in range(6)})


def known(strategy, history, pending=()):
    return Surrogates(strategy, read_record(strategy.space, strategy.features, history, pending))


def study(space, f, n, *, name="random", features=None, seed=0, z=None):
    """A study of `n` uniform points; `f` gives value, or value and behaviour."""
    strategy = make_strategy(name, space, features=features)
    rng = np.random.default_rng(seed)
    history = []
    for u in rng.random((n, space.d)):
        params = space.from_unit(u)
        level = None if z is None else float(rng.choice(z))
        found = f(params) if level is None else f(params, level)
        value, behaviour = found if isinstance(found, tuple) else (found, None)
        history.append(Observation(Candidate(params, level), value=value, features=behaviour, cost=1.0))
    return known(strategy, history)


def two_matter(p):
    """x1 matters most, x4 less, nothing else."""
    return math.sin(6 * p["x1"]) + 0.5 * (p["x4"] - 0.3) ** 2 * 4


class TestImportances:
    @pytest.mark.parametrize("seed", [0, 1, 2])
    def test_both_rank_the_parameters_that_matter_first(self, seed):
        found = importances(study(SIX, two_matter, 60, seed=seed), "value", np.random.default_rng(0))
        assert [each.name for each in found.parameters[:2]] == ["x1", "x4"]
        by_length = sorted(found.parameters, key=lambda each: -each.from_length_scales)
        assert {each.name for each in by_length[:2]} == {"x1", "x4"}
        assert sum(each.from_length_scales for each in found.parameters) == pytest.approx(1)
        assert found.agreement > 0
        assert found.explained > 0.9

    def test_intervals_tell_what_matters_from_what_does_not(self):
        found = {
            each.name: each
            for each in importances(study(SIX, two_matter, 80), "value", np.random.default_rng(0)).parameters
        }
        assert found["x1"].interval[0] > 0.1
        assert found["x4"].interval[0] > 0.01
        for name in ("x0", "x2", "x3", "x5"):
            low, high = found[name].interval
            assert low <= found[name].permutation <= high
            assert high < 0.1

    def test_an_exact_surrogate_gives_twice_the_total_sobol_index(self):
        # f = x0 + 2 x1: the total index of x0 is var(x0) / var(f), of x1 4 var(x1) / var(f), here of the sample
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        asked = study(space, lambda p: p["x0"] + 2 * p["x1"], 200)
        found = importances(asked, "value", np.random.default_rng(0))
        by_name = {each.name: each.permutation for each in found.parameters}
        variances = asked.record.X.var(0) * [1, 4] / asked.record.value.var()
        assert by_name["x0"] == pytest.approx(2 * variances[0], rel=0.1)
        assert by_name["x1"] == pytest.approx(2 * variances[1], rel=0.1)

    def test_a_behaviour_has_importances_of_its_own(self):
        def turns(p):
            return p["x0"], [math.atan2(math.sin(5 * p["x2"]), math.cos(5 * p["x2"]))]

        asked = study(SIX, turns, 60, name="bds", features=Features.circle())
        assert asked.subject == "behaviour"
        of_behaviour = importances(asked, "behaviour", np.random.default_rng(0))
        of_value = importances(asked, "value", np.random.default_rng(0))
        assert (of_behaviour.parameters[0].name, of_value.parameters[0].name) == ("x2", "x0")

    def test_categories_and_angles_are_permuted_as_one(self):
        space = Space({"kind": Categorical(("a", "b", "c")), "turn": Angle(), "idle": Float(0.0, 1.0)})
        asked = study(space, lambda p: {"a": 0.0, "b": 1.0, "c": -1.0}[p["kind"]] + 0.3 * math.cos(p["turn"]), 80)
        found = importances(asked, "value", np.random.default_rng(0))
        assert [each.name for each in found.parameters] == ["kind", "turn", "idle"]

    def test_noise_explains_nothing_and_says_so(self):
        rng = np.random.default_rng(5)
        found = importances(study(SIX, lambda _: float(rng.standard_normal()), 60), "value", np.random.default_rng(0))
        assert found.explained < 0.1

    def test_of_cmfbo_they_are_taken_with_its_own_kernel(self):
        # ten observations in ten folds: each is predicted from all others, as the process itself can leave one out
        asked = study(SIX, lambda p, z: math.sin(4 * p["x1"]) - z * p["x4"], 10, name="cmfbo", z=[0.1, 0.5, 1.0])
        found = importances(asked, "value", np.random.default_rng(0))
        process = asked.process("value")
        missed = np.square(process.leave_one_out()[0] - process.Y).mean() / process.Y.var()
        assert found.explained == pytest.approx(1 - missed, rel=1e-6)

    def test_few_observations_say_nothing(self):
        assert importances(study(SIX, two_matter, 5), "value", np.random.default_rng(0)) is None
        assert importances(study(SIX, lambda _: 1.0, 20), "value", np.random.default_rng(0)) is None


class TestSlices:
    def test_a_slice_shows_the_function_in_its_own_unit(self):
        asked = study(SIX, lambda p: 100 + 40 * two_matter(p), 150, name="gp_ucb")
        shown = slice_of(asked, Ask("x1", "x4", size=9, at={"x0": 0.5}))
        assert shown.mean.shape == (9, 9)
        truth = [[100 + 40 * two_matter({"x1": a, "x4": b}) for a in shown.x.values] for b in shown.y.values]
        assert np.abs(shown.mean - truth).max() < 6
        assert (shown.deviation >= 0).all()
        assert shown.deviation.max() < 20
        assert set(shown.others) == {"x0", "x2", "x3", "x5"}
        assert shown.others["x0"] == 0.5
        assert shown.notes[0] == "The surrogate that gp_ucb proposes from."

    def test_samples_far_from_the_slice_are_faint(self):
        asked = study(SIX, two_matter, 60)
        best = int(np.argmax(asked.record.value))
        shown = {each.index: each for each in slice_of(asked, Ask("x0", "x2", size=5)).samples}
        # the slice goes through the best observation
        assert shown[best].near == pytest.approx(1.0)
        assert len(shown) == 60
        # what matters stays at the best, so a sample that is far in it tells little about this slice
        far = int(np.argmax(np.abs(asked.record.X[:, 1] - asked.record.X[best, 1])))
        assert shown[far].near < 0.3

    def test_the_difficulty_moves_the_slice(self):
        def curved(p, z):
            return -((p["x0"] - 0.5) ** 2) + 3 * z

        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        asked = study(space, curved, 60, name="cmfbo", z=[0.2, 0.5, 1.0])
        easy = slice_of(asked, Ask("x0", "x1", z=0.2, size=5))
        hard = slice_of(asked, Ask("x0", "x1", z=1.0, size=5))
        assert np.abs(hard.mean - easy.mean - 2.4).max() < 0.3
        assert hard.acquisition_name == "expected improvement at z = 1"
        assert (hard.acquisition >= 0).all()
        assert np.allclose(hard.acquisition, easy.acquisition)

    def test_cmfbo_shows_the_very_surrogate_that_it_proposes_from(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        asked = study(space, lambda p, z: math.sin(3 * p["x0"]) + p["x1"] * z, 38, name="cmfbo", z=[0.2, 0.5, 1.0])
        joint, _, _ = make_strategy("cmfbo", space).surrogates(asked.record)
        shown = slice_of(asked, Ask("x0", "x1", z=0.5, size=6))
        U = np.array([[a, b] for b in shown.y.unit for a in shown.x.unit])
        mean, sigma = joint.posterior(U, 0.5)
        natural = (mean + joint.scale.trend * -0.5) * joint.scale.spread + joint.scale.middle
        assert shown.mean == pytest.approx(natural.reshape(6, 6), abs=1e-12)
        assert shown.deviation == pytest.approx((sigma * joint.scale.spread).reshape(6, 6), abs=1e-12)

    def test_a_slice_says_when_easy_levels_are_left_out_because_they_mislead(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})

        def misled(p, z):
            return math.sin(9 * p["x0"]) if z == 1 else 2 * math.cos(9 * p["x0"]) + p["x1"]

        asked = study(space, misled, 60, name="cmfbo", z=[0.2, 1.0])
        hard = slice_of(asked, Ask("x0", "x1", size=5))
        assert hard.notes[0] == "The surrogate that cmfbo proposes from."
        assert hard.notes[1].startswith("It is of z = 1 alone: easier levels help to predict it with a probability of")
        easy = slice_of(asked, Ask("x0", "x1", z=0.2, size=5))
        assert "because one is shown" in easy.notes[1]
        assert np.allclose(easy.acquisition, hard.acquisition)

        def helped(p, z):
            return math.sin(9 * p["x0"]) + 0.3 * (1 - z)

        good = slice_of(study(space, helped, 60, name="cmfbo", z=[0.2, 1.0]), Ask("x0", "x1", size=5))
        assert good.notes[1].startswith("Easier levels are in it: they help to predict z = 1")

    def test_a_published_form_is_said_to_have_a_surrogate_of_its_own(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        strategy = make_strategy("cmfbo", space, settings={"variant": "published"})
        history = [
            Observation(Candidate(space.from_unit(u), z=1.0), value=float(u.sum()), cost=1.0)
            for u in np.random.default_rng(0).random((8, 2))
        ]
        shown = slice_of(known(strategy, history), Ask("x0", "x1", size=5))
        assert "cmfbo as published proposes from one that is fitted in another way" in shown.notes[0]
        assert shown.acquisition is None

    def test_novelty_is_small_where_behaviours_are_known(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        strategy = make_strategy("bds", space, features=Features.circle())
        history = [
            Observation(Candidate({"x0": a, "x1": b}), features=[a * 2 - 1], value=1.0)
            for a in (0.0, 0.15, 0.3)
            for b in (0.0, 0.5, 1.0)
        ]
        shown = slice_of(known(strategy, history), Ask("x0", "x1", "novelty", size=7))
        assert shown.mean[:, 1].max() < shown.mean[:, -1].min()
        assert shown.acquisition is not None
        assert np.allclose(shown.acquisition, shown.mean)  # nothing has failed, so everything is feasible

    def test_a_behaviours_coordinate_is_shown_in_its_unit(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        asked = study(
            space, lambda p: (1.0, [10 + 20 * p["x1"]]), 40, name="bds", features=Features.euclidean(1, 0.0, 40.0)
        )
        shown = slice_of(asked, Ask("x0", "x1", "feature:0", size=5))
        assert np.abs(shown.mean - (10 + 20 * np.array(shown.y.values))[:, None]).max() < 1.5
        assert (shown.deviation < 4).all()

    def test_failures_show_as_infeasible(self):
        space = Space({"x0": Float(0.0, 1.0), "x1": Float(0.0, 1.0)})
        strategy = make_strategy("bds", space, features=Features.circle())
        rng = np.random.default_rng(0)
        history = [
            Observation(
                Candidate({"x0": a, "x1": b}),
                value=1.0,
                features=[a] if a < 0.5 else None,
                status="complete" if a < 0.5 else "failed",
            )
            for a, b in rng.random((40, 2))
        ]
        shown = slice_of(known(strategy, history), Ask("x0", "x1", "feasible", size=5))
        assert shown.mean[:, 0].min() > 0.6
        assert shown.mean[:, -1].max() < 0.4
        assert ((shown.mean >= 0) & (shown.mean <= 1)).all()

    def test_discrete_axes_have_their_values(self):
        space = Space({"n": Int(1, 4), "kind": Categorical(("a", "b")), "w": Int(1, 1000, log=True)})
        assert axis(space, "n", 40).values == (1, 2, 3, 4)
        assert axis(space, "kind", 40).values == ("a", "b")
        wide = axis(space, "w", 40)
        assert (wide.values[0], wide.values[-1], wide.scale) == (1, 1000, "log")
        assert len(wide.values) <= 40
        assert list(wide.values) == sorted(set(wide.values))

    def test_a_circle_reaches_both_edges(self):
        side = axis(Space({"turn": Angle()}), "turn", 5)
        assert side.scale == "angle"
        assert side.values == pytest.approx((-math.pi, -math.pi / 2, 0, math.pi / 2, math.pi))

    def test_one_parameter_makes_a_line(self):
        asked = study(Space({"x0": Float(0.0, 1.0)}), lambda p: p["x0"], 12)
        shown = slice_of(asked, Ask("x0", None, size=7))
        assert shown.y is None
        assert shown.mean.shape == (1, 7)

    @pytest.mark.parametrize(
        ("ask", "message"),
        [
            (Ask("nothing", "x1"), "expected a parameter among x0, x1, x2, x3, x4, x5, found 'nothing'"),
            (Ask("x1", "x1"), "two different parameters, found 'x1' twice"),
            (Ask("x0", "x1", "novelty"), "output: expected one of value, found 'novelty'"),
            (Ask("x0", "x1", "feature:0"), "expected one of value"),
            (Ask("x0", "x1", at={"x9": 1.0}), "at: expected parameters among"),
            (Ask("x0", "x1", at={"x2": 7.0}), r"at: parameter 'x2': expected a value in \[0.0, 1.0\], found 7.0"),
            (Ask("x0", "x1", at={"x2": None}), "expected a number, found None"),
            (Ask("x0", "x1", size=200), f"at most {LARGEST_GRID} grid points"),
        ],
    )
    def test_what_cannot_be_shown_is_said(self, ask, message):
        with pytest.raises(BadParams, match=message):
            slice_of(study(SIX, two_matter, 12), ask)

    def test_before_anything_is_known_there_is_nothing(self):
        with pytest.raises(NothingYet, match="no trial is complete yet"):
            slice_of(study(SIX, two_matter, 0), Ask("x0", "x1"))


class TestNarrowed:
    def test_what_matters_is_narrowed_around_the_best_and_the_rest_stays(self):
        space = Space({
            "a": Float(1e-5, 1e-1, log=True), "b": Float(0.0, 10.0), "n": Int(1, 100), "c": Categorical(("u", "v")),
            "turn": Angle(),
        })  # fmt: skip
        best = space.to_unit({"a": 1e-3, "b": 9.9, "n": 7, "c": "v", "turn": 0.0})
        found = narrowed(space, best, np.array([0.5, 0.2, 0.01, 1.0, 3.0]))
        assert found["a"] == Float(1e-4, 1e-2, log=True)
        assert found["b"] == Float(8.9, 10.0)
        assert (found["n"].low, found["n"].high) == (2, 12)
        assert found["c"] == Categorical(("v",))
        assert found["turn"] == Angle()
        Space(found).to_unit({"a": 1e-3, "b": 9.9, "n": 7, "c": "v", "turn": 0.0})

    def test_something_is_always_left_to_search(self):
        space = Space({"c": Categorical(("u", "v"))})
        assert narrowed(space, np.array([0.25]), np.array([0.1])) == {"c": Categorical(("u", "v"))}
