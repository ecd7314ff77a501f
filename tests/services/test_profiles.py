"""Profiles: named sections laid over a study file, one of which is chosen; checked like everything else."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.admission import StudyChanged, admit, changes_of
from services.located_yaml import Located
from services.problems import BadStudy
from services.profiles import choose
from services.spec_check import parse_study
from services.spec_file import draft
from services.store.open import open_store

FILE = """\
name: hop
task: point_jump
search: {strategy: random, trials: 40}
training:
  budget: {samples: 15000}
  network: {hidden: [64, 64], activation: tanh}
profiles:
  quick:
    name: hop-quick
    task: {settings: {bar: 0.5}}
    search: {trials: 4}
    training:
      network: {hidden: [8]}
  paper:
    training: {budget: {samples: 90000}}
"""


def problems(text, *overrides):
    return [str(problem) for problem in draft(text, name="a.yaml", overrides=overrides).problems]


def refusal(text, *overrides):
    with pytest.raises(BadStudy) as caught:
        draft(text, name="a.yaml", overrides=overrides)
    return str(caught.value)


def test_a_profile_is_merged_over_the_file_and_its_name_kept():
    spec = draft(FILE, name="a.yaml", overrides=["profile=quick"]).spec
    assert (spec.name, spec.profile) == ("hop-quick", "quick")
    assert (spec.task.name, spec.task.settings) == ("point_jump", {"bar": 0.5})
    assert (spec.search.strategy, spec.search.trials) == ("random", 4)
    assert spec.training == {"budget": {"samples": 15000}, "network": {"hidden": [8], "activation": "tanh"}}


def test_without_a_choice_the_file_stands_as_it_is():
    spec = draft(FILE, name="a.yaml").spec
    assert (spec.name, spec.profile, spec.search.trials) == ("hop", None, 40)
    assert "profiles" not in spec.to_json()


def test_the_file_may_choose_and_the_command_line_has_the_last_word():
    text = FILE.replace("name: hop\n", "name: hop\nprofile: paper\n", 1)
    assert draft(text, name="a.yaml").spec.training["budget"] == {"samples": 90000}
    assert draft(text, name="a.yaml", overrides=["profile=quick"]).spec.profile == "quick"


def test_an_override_wins_over_the_profile_wherever_it_stands():
    spec = draft(FILE, name="a.yaml", overrides=["search.trials=7", "profile=quick"]).spec
    assert (spec.search.trials, spec.name) == (7, "hop-quick")


def test_an_unknown_profile_names_those_there_are():
    expected = "--profile quikc: profile: expected a profile of this file, found the text 'quikc'; did you mean quick?"
    assert refusal(FILE, "profile=quikc") == expected
    assert refusal(FILE, "profile=x").endswith("found the text 'x'; known: paper, quick")
    text = FILE.replace("name: hop\n", "name: hop\nprofile: slow\n", 1)
    assert refusal(text).startswith("a.yaml:2: profile: expected a profile of this file, found the text 'slow'")
    plain = FILE.partition("profiles:")[0]
    assert refusal(plain, "profile=quick").endswith(
        "expected a file with profiles to choose from, found the text 'quick' and none"
    )


def test_what_is_wrong_in_a_profile_is_told_with_its_own_line_and_field():
    text = FILE.replace("{trials: 4}", "{trials: -4}")
    wrong = "a.yaml:11: profiles.quick.search.trials: expected a number above 0, found -4"
    assert problems(text, "profile=quick") == [wrong]


def test_a_profile_that_was_not_chosen_is_checked_too():
    text = FILE.replace("{trials: 4}", "{trails: 4}")
    wrong = "a.yaml:11: profiles.quick.search.trails: expected a known key, found trails; did you mean trials?"
    assert problems(text) == [wrong]
    assert problems(text, "profile=paper") == [wrong]


def test_what_is_wrong_outside_of_the_profiles_is_told_once():
    text = FILE.replace("strategy: random", "strategy: 3")
    assert problems(text) == ["a.yaml:3: search.strategy: expected text, found 3"]


def test_the_task_is_asked_about_a_profiles_settings_with_their_line():
    text = FILE.replace("{bar: 0.5}", "{bar: 50}")
    with pytest.raises(BadStudy) as caught:
        parse_study(text, name="a.yaml", overrides=["profile=quick"])
    assert str(caught.value).startswith("a.yaml:10: profiles.quick.task.settings.bar: expected a number from 0.3 to 3")


@pytest.mark.parametrize(
    ("profiles", "message"),
    [
        ("[quick]", "a.yaml:8: profiles: expected profiles by name, for example quick: {search: {trials: 4}}"),
        ("{quick: 3}", "a.yaml:8: profiles.quick: expected the sections that it changes"),
        ("{quick: {profile: x}}", "a.yaml:8: profiles.quick.profile: expected a section of a study, found profile"),
        ("{quick: {profiles: {}}}", "a.yaml:8: profiles.quick.profiles: expected a section of a study"),
    ],
)
def test_what_is_no_profile_is_refused(profiles, message):
    text = FILE.partition("profiles:")[0] + f"\nprofiles: {profiles}\n"
    assert refusal(text).startswith(message)


def test_a_list_that_became_shorter_keeps_no_line_of_the_old_one():
    text = FILE.replace("hidden: [8]", "hidden: [-8]")
    with pytest.raises(BadStudy) as caught:
        parse_study(text, name="a.yaml", overrides=["profile=quick"])
    assert str(caught.value).startswith("a.yaml:13: profiles.quick.training.network.hidden[0]: expected a whole number")


def test_another_profile_is_another_study(tmp_path):
    store = open_store(tmp_path / "halma.db")
    quick = parse_study(FILE, name="a.yaml", overrides=["profile=quick", "name=hop"])
    row = admit(store, quick)
    assert row.spec["profile"] == "quick"
    assert not changes_of(row, quick, "a.yaml:1", "halma run a.yaml --name NEW")
    paper = parse_study(FILE, name="a.yaml", overrides=["profile=paper"])
    with pytest.raises(StudyChanged, match=r"profile: the text 'quick' in the study, the text 'paper' in the file"):
        changes_of(row, paper, "a.yaml:1", "halma run a.yaml --name NEW")
    store.close()


trees = st.recursive(
    st.integers() | st.none() | st.lists(st.integers(), max_size=2),
    lambda inner: st.dictionaries(st.sampled_from("abc"), inner, max_size=3),
    max_leaves=8,
)


def merged(below, above):
    """The slow obvious version."""
    if not (isinstance(below, dict) and isinstance(above, dict)):
        return above
    return {
        key: above[key] if key not in below else below[key] if key not in above else merged(below[key], above[key])
        for key in {*below, *above}
    }


@given(st.dictionaries(st.sampled_from("abc"), trees), st.dictionaries(st.sampled_from("abc"), trees))
def test_merging_is_key_by_key_and_leaves_the_file_alone(base, sections):
    document = Located({**base, "profiles": {"p": sections}})
    assert choose(document, "p").value == {**merged(base, sections), "profile": "p"}
    assert document.value == {**base, "profiles": {"p": sections}}
