"""What the API tells of what a search has learnt."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, replace

import numpy as np
import pytest

from search import Categorical, Float
from services.insight import looked_at
from services.lineage import learnt_before
from services.space_text import space_yaml
from services.spec_check import parse_study
from services.states import TrialState
from services.store.port import Driver, NewTrial, Result
from tests.record import Record


@pytest.fixture
def jumps(record):
    """Twelve finished trials of a diversity study, a failure among them, and one that runs."""
    for _ in range(11):
        record.one(iterations=1, files=())
    record.one(iterations=1, files=(), state=TrialState.FAILED, message="it fell")
    record.start(record.propose()[0])
    return record


def tuned(store, name="tuned", strategy="cmfbo", trials=24):
    """A quality study with difficulties and warm starts: the value falls away from rate 1e-3, whatever the width."""
    spec = {
        "name": name,
        "task": {"name": "hills", "settings": {}},
        "space": {
            "rate": {"type": "float", "low": 1e-5, "high": 1e-1, "log": True},
            "width": {"type": "int", "low": 16, "high": 256, "log": False},
            "kind": {"type": "categorical", "choices": ["relu", "tanh: soft"]},
        },
        "search": {"strategy": strategy, "settings": {}, "trials": 100, "cost": None},
        "behaviour": None,
        "units": {"rate": "1/step"},
        "has_difficulty": True,
        "trains": False,
    }
    rng = np.random.default_rng(0)
    with store.transaction() as change:
        study = change.create_study(name, spec, seed=3, target_trials=100)
        token = change.drive(name, Driver("d", "here", 1))
        for number in range(trials):
            params = {
                "rate": float(10 ** rng.uniform(-5, -1)),
                "width": int(rng.integers(16, 257)),
                "kind": ["relu", "tanh: soft"][number % 2],
            }
            z = 0.2 if number % 3 else 1.0
            new = NewTrial(params, seed=number, z=z, warm_start=number - 1 if number % 3 == 0 and number else None)
            (trial,) = change.propose(
                study.id, token, strategy=strategy, history=number, pending=(), rng_key=(3, number), seconds=0.1,
                trials=[new],
            )  # fmt: skip
            attempt = change.start(trial.id, token, worker="w")
            value = z * (10 - (np.log10(params["rate"]) + 3) ** 2)
            samples = int(1000 * z)
            change.finish(
                attempt.id, attempt.token, Result(TrialState.COMPLETE, float(value), samples=samples, seconds=2.0 * z)
            )
    return study


@dataclass
class BestTrial:
    params: dict
    number: int = 7
    value: float = 0.5


class TestSlice:
    def test_a_diversity_study_shows_novelty_by_itself(self, client, jumps):
        shown = client.get("/api/v1/studies/jump/slice", params={"x": "omega_x", "y": "alpha", "size": 9}).json()
        assert shown["output"] == {
            "name": "novelty", "label": "distance to the nearest known behaviour", "unit": "rad",
        }  # fmt: skip
        assert (shown["x"]["label"], shown["x"]["unit"], shown["x"]["scale"]) == ("omega x", "rad/s", "linear")
        assert (shown["y"]["scale"], shown["y"]["unit"]) == ("angle", "rad")
        assert np.shape(shown["mean"]) == np.shape(shown["deviation"]) == np.shape(shown["acquisition"]) == (9, 9)
        assert len(shown["samples"]) == 12
        assert [each["state"] for each in shown["samples"]].count("failed") == 1
        assert [(each["number"], each["state"]) for each in shown["pending"]] == [(12, "running")]
        assert shown["others"] == {}
        assert "bds proposes from" in shown["note"]

    def test_the_next_proposal_is_the_one_the_service_would_make(self, client, store, jumps):
        from services.proposing import ProposalRequest, Proposer, candidate_json, observation_json, proposal_key

        told = client.get("/api/v1/studies/jump/slice").json()["next"]
        row = store.study("jump")
        history = store.history(row.id)
        proposed = Proposer(row.spec).propose(
            ProposalRequest(
                study=row.id,
                start=0,
                history=len(history),
                observations=[observation_json(trial) for trial in history],
                pending=[candidate_json(trial) for trial in store.trials(row.id, states=[TrialState.RUNNING])],
                count=1,
                rng_key=proposal_key(7, 13),
            )
        )
        assert told["params"] == proposed.candidates[0]["params"]
        assert told["info"]["mode"].startswith("diversify")

    def test_a_quality_study_shows_its_value_at_a_difficulty(self, client, store):
        tuned(store)
        query = {"x": "rate", "y": "width", "size": 7}
        hard = client.get("/api/v1/studies/tuned/slice", params=query).json()
        easy = client.get("/api/v1/studies/tuned/slice", params={**query, "z": 0.2}).json()
        assert hard["output"]["name"] == "value"
        assert hard["x"]["scale"] == "log"
        assert np.max(hard["mean"]) > 8
        assert np.max(easy["mean"]) < 4
        # the best rate lies in the middle of the axis, whatever the width
        assert np.argmax(hard["mean"], axis=1).tolist() == [3] * 7
        assert hard["others"] == {"kind": hard["others"]["kind"]}
        assert hard["acquisition_name"] == "expected improvement at z = 1"

    def test_axes_that_are_not_asked_for_are_those_that_matter(self, client, store):
        tuned(store)
        assert client.get("/api/v1/studies/tuned/slice", params={"size": 3}).json()["x"]["name"] == "rate"

    def test_other_strategies_get_a_surrogate_for_looking(self, client, store):
        tuned(store, strategy="random")
        shown = client.get("/api/v1/studies/tuned/slice", params={"x": "rate", "y": "kind", "size": 5}).json()
        assert shown["note"].startswith("A surrogate fitted for looking: random does not propose")
        assert (shown["acquisition"], shown["next"]) == (None, None)
        assert shown["y"]["values"] == ["relu", "tanh: soft"]
        assert np.shape(shown["mean"]) == (2, 5)

    def test_sliders_move_the_others(self, client, store):
        tuned(store, trials=48)
        query = {"x": "width", "y": "kind", "size": 3}
        at = [
            client.get("/api/v1/studies/tuned/slice", params={**query, "at": json.dumps({"rate": rate})}).json()
            for rate in (1e-5, 1e-3)
        ]
        assert at[0]["others"] == {"rate": pytest.approx(1e-5)}
        assert np.mean(at[1]["mean"]) > np.mean(at[0]["mean"]) + 2

    def test_before_the_first_result_it_says_so(self, client, record):
        shown = client.get("/api/v1/studies/jump/slice", params={"x": "alpha", "y": "omega_x"}).json()
        assert (shown["mean"], shown["samples"]) == ([], [])
        assert shown["note"] == "No trial is complete yet, so there is nothing to fit a surrogate to."
        # the first proposal is known all the same
        assert shown["next"]["info"]["mode"] == "start"

    @pytest.mark.parametrize(
        ("query", "message"),
        [
            ({"x": "speed"}, "slice: expected a parameter among alpha, omega_x, found 'speed'"),
            ({"x": "alpha", "y": "alpha"}, "two different parameters"),
            ({"output": "feature:1"}, "output: expected one of value, novelty, feature:0, feasible (facing)"),
            ({"at": "{"}, "at: expected a JSON object of parameter values, found no JSON"),
            ({"at": "[1]"}, "found list"),
            ({"at": '{"alpha": "left"}'}, "at: parameter 'alpha': an angle: expected a number, found 'left'"),
            ({"z": 2}, "z: Input should be less than or equal to 1"),
            ({"z": "nan"}, "z: "),
            ({"size": 1000}, "size: "),
        ],
    )
    def test_what_is_wrong_is_named(self, client, jumps, query, message):
        answer = client.get("/api/v1/studies/jump/slice", params=query)
        assert answer.status_code == 422
        assert message in answer.json()["error"]["message"]

    def test_an_unknown_study_is_not_found(self, client, jumps):
        for what in ("slice", "importance", "ladder", "lineage", "curves?numbers=1"):
            assert client.get(f"/api/v1/studies/jumb/{what}").status_code == 404

    def test_the_same_look_is_worked_out_once_and_again_when_a_trial_ends(self, client, jumps, monkeypatch):
        import services.insight

        calls = []
        original = services.insight.slice_json
        monkeypatch.setattr(services.insight, "slice_json", lambda *a: calls.append(1) or original(*a))
        first = client.get("/api/v1/studies/jump/slice").json()
        assert client.get("/api/v1/studies/jump/slice").json() == first
        assert len(calls) == 1
        jumps.one(iterations=1, files=())
        again = client.get("/api/v1/studies/jump/slice").json()
        assert again["observations"] == first["observations"] + 1
        assert len(calls) == 2

    def test_a_slow_look_holds_up_nobody(self, client, app, jumps):
        hold, started = threading.Event(), threading.Event()

        def slow():
            started.set()
            hold.wait(20)

        looking = app.state.service.looks._thread.submit(slow)
        assert started.wait(5)
        try:
            with client.websocket_connect("ws://localhost:8642/api/v1/events?study=jump") as socket:
                assert socket.receive_json()["type"] == "hello"
            assert client.get("/api/v1/studies/jump").status_code == 200
        finally:
            hold.set()
        looking.result(5)


def test_long_histories_are_looked_at_anew_every_percent_or_two():
    assert [looked_at(n) for n in (0, 1, 199, 200, 201)] == [0, 1, 199, 200, 200]
    for n in range(1, 60_000, 37):
        seen = looked_at(n)
        assert 0 <= n - seen <= max(1, 0.02 * n)
        assert looked_at(seen) == seen


class TestImportance:
    def test_the_parameter_that_matters_comes_first(self, client, store):
        tuned(store, trials=45)
        found = client.get("/api/v1/studies/tuned/importance").json()
        assert found["of"] == "value"
        first = found["parameters"][0]
        assert (first["name"], first["unit"]) == ("rate", "1/step")
        assert first["interval"][0] <= first["permutation"] <= first["interval"][1]
        assert first["from_length_scales"] == max(each["from_length_scales"] for each in found["parameters"])
        assert first["permutation"] > 3 * found["parameters"][1]["permutation"]

    @pytest.mark.parametrize("strategy", ["cmfbo", "random"])
    def test_the_best_setting_can_be_pasted_into_a_study_file(self, client, store, strategy):
        tuned(store, strategy=strategy)
        best = client.get("/api/v1/studies/tuned/importance").json()["best"]
        row = store.study("tuned")
        at_top = [trial for trial in store.history(row.id) if trial.z == 1.0]
        assert best["number"] == max(at_top, key=lambda trial: trial.value).number
        assert store.trial(row.id, best["number"]).params == best["params"]
        head = "name: again\ntask: tests.services.cli.sample_hills:bare_hill\nsearch: {strategy: random, trials: 2}\n"
        pasted = parse_study(head + best["yaml"], name="again.yaml")
        assert set(pasted.space) == {"rate", "width", "kind"}
        assert 1e-5 <= pasted.space["rate"].low < best["params"]["rate"] < pasted.space["rate"].high <= 1e-1
        assert pasted.space["width"].low <= best["params"]["width"] <= pasted.space["width"].high
        assert pasted.space["kind"].choices == (best["params"]["kind"],)
        assert pasted.space["rate"].log

    @pytest.mark.parametrize("strategy", ["cmfbo", "random"])
    def test_the_best_setting_says_so_where_its_policy_was_handed_on(self, client, store, strategy):
        tuned(store, strategy=strategy)
        best = client.get("/api/v1/studies/tuned/importance").json()["best"]
        parent = store.trial(store.study("tuned").id, best["number"]).warm_start
        assert ("had learnt in another trial before: from scratch" in best["yaml"]) == (parent is not None)

    def test_what_a_policy_went_through_is_counted_along_its_line(self, store):
        tuned(store)
        first, second, third = store.history(store.study("tuned").id)[:3]
        line = [
            replace(first, warm_start=None),
            replace(second, warm_start=first.number),
            replace(third, warm_start=second.number),
        ]
        assert [learnt_before(trial, line) for trial in line] == [0, 1, 2]
        assert learnt_before(line[2], []) == 1, "a parent that is not among the trials still was one"
        anew = replace(line[1], details={"warm_start": {"parent": first.number, "networks": False}})
        assert learnt_before(anew, line) == 0, "networks of another size hand on nothing that was learnt"
        assert learnt_before(line[2], [line[0], anew, line[2]]) == 1
        assert "in 2 other trials before: from scratch" in space_yaml({}, line[2], 2)
        assert "from scratch" not in space_yaml({}, line[0], 0)

    @pytest.mark.parametrize("name", ["on", "1e-4", "a: b", "ppo.clip", "~", 'say "hi"', "α", "null", "#x"])
    def test_names_that_yaml_would_misread_are_quoted(self, name):
        from services.located_yaml import parse

        text = space_yaml({name: Float(0.0, 1.0), "c": Categorical((name,))}, BestTrial({name: 0.5, "c": name}))
        space = parse(text).value["space"]
        assert set(space) == {name, "c"}
        assert space["c"]["choices"] == [name]

    def test_an_easier_trial_is_never_the_best_setting(self, client, record):
        record.one(iterations=1, files=(), z=0.5)
        assert client.get("/api/v1/studies/jump/importance").json()["best"] is None

    def test_a_behaviour_that_plays_no_part_is_refused(self, client, store):
        tuned(store)
        answer = client.get("/api/v1/studies/tuned/importance?of=behaviour")
        assert answer.status_code == 422
        assert "behaviour plays no part" in answer.json()["error"]["message"]

    def test_few_trials_tell_nothing(self, client, record):
        found = client.get("/api/v1/studies/jump/importance").json()
        assert found["parameters"] == []
        assert "Too few complete trials (0) to tell" in found["note"]


class TestFidelity:
    def test_the_ladder_adds_up(self, client, store):
        tuned(store, trials=9)
        found = client.get("/api/v1/studies/tuned/ladder").json()
        assert [(each["z"], each["trials"], each["samples"], each["seconds"]) for each in found["levels"]] == [
            (0.2, 6, 1200, 2.4),
            (1.0, 3, 3000, 6.0),
        ]
        assert [point["number"] for point in found["points"]] == list(range(9))
        assert found["next"] is None

    def test_points_come_in_pages(self, client, store):
        tuned(store, trials=9)
        numbers, after = [], ""
        while after is not None:
            page = client.get(f"/api/v1/studies/tuned/ladder?limit=4{after and f'&page={after}'}").json()
            numbers += [point["number"] for point in page["points"]]
            after = page["next"]
        assert numbers == list(range(9))

    def test_a_study_without_difficulties_has_no_ladder(self, client, store, artifacts):
        study = Record(store, artifacts, "flat").begin()
        with store.transaction() as change:
            change.propose(
                study.id, study.token, strategy="bds", history=0, pending=(), rng_key=(1,), seconds=0.1,
                trials=[NewTrial({"omega_x": 0.0, "alpha": 0.0}, seed=1)],
            )  # fmt: skip
        assert client.get("/api/v1/studies/flat/ladder").json() == {"levels": [], "points": [], "next": None}

    def test_the_lineage_names_parents_and_children(self, client, store):
        tuned(store, trials=9)
        found = client.get("/api/v1/studies/tuned/lineage").json()
        assert [(edge["parent"], edge["child"]) for edge in found["edges"]] == [(2, 3), (5, 6)]
        assert [node["number"] for node in found["nodes"]] == [2, 3, 5, 6]
        page = client.get("/api/v1/studies/tuned/lineage?limit=1").json()
        assert [edge["child"] for edge in page["edges"]] == [3]
        assert [
            edge["child"] for edge in client.get(f"/api/v1/studies/tuned/lineage?page={page['next']}").json()["edges"]
        ] == [6]


class TestCurves:
    def test_curves_are_laid_over_each_other(self, client, record):
        record.one(iterations=3)
        record.one(iterations=2)
        found = client.get("/api/v1/studies/jump/curves?numbers=1,0&metric=bar").json()
        assert [(curve["number"], curve["iterations"]) for curve in found["curves"]] == [(1, [1, 2]), (0, [1, 2, 3])]
        assert found["curves"][1]["values"] == [0.52, 0.54, 0.56]
        assert found["metrics"] == ["bar", "kl", "return", "samples_per_second", "success"]

    def test_the_return_is_shown_by_itself(self, client, record):
        record.one(iterations=1)
        assert client.get("/api/v1/studies/jump/curves?numbers=0").json()["metric"] == "return"

    def test_a_long_curve_is_thinned_and_keeps_its_end(self, client, record):
        (trial,) = record.propose()
        attempt = record.start(trial)
        with record.store.transaction() as change:
            for i in range(1, 2502):
                change.report(
                    attempt.id, attempt.token, iteration=i, metrics={"return": float(i)}, samples=i, seconds=0.0
                )
        (curve,) = client.get("/api/v1/studies/jump/curves?numbers=0").json()["curves"]
        assert len(curve["iterations"]) <= 1000
        assert curve["iterations"][-1] == 2501
        assert set(np.diff(curve["iterations"])) == {3}

    @pytest.mark.parametrize(
        ("query", "status", "message"),
        [
            ("numbers=0,77", 404, "trial 77"),
            ("numbers=a", 422, "numbers"),
            ("numbers=0&metric=speed", 422, "found 'speed'"),
            ("numbers=" + ",".join(map(str, range(21))), 422, "at most 20 trials, found 21"),
        ],
    )
    def test_what_is_wrong_is_named(self, client, record, query, status, message):
        record.one(iterations=1)
        answer = client.get(f"/api/v1/studies/jump/curves?{query}")
        assert answer.status_code == status
        assert message in answer.json()["error"]["message"]
