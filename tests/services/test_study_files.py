"""The study files that come with halma are good, in each of their profiles."""

from pathlib import Path

import pytest

from services.located_yaml import parse
from services.profiles import profiles_of
from services.spec_check import load_study

STUDIES = Path(__file__).parents[2] / "studies"
FILES = sorted(STUDIES.glob("*.yaml"))


def every_profile():
    for file in FILES:
        for profile in (None, *profiles_of(parse(file.read_text(encoding="utf-8")).value)):
            yield pytest.param(file, profile, id=f"{file.stem}-{profile}")


@pytest.mark.parametrize(("file", "profile"), list(every_profile()))
def test_a_study_file_is_good_in_each_profile(file, profile):
    spec = load_study(file, [] if profile is None else [f"profile={profile}"])
    assert spec.space
    assert spec.search.trials or spec.search.cost


@pytest.mark.parametrize("name", ["high_jump", "obstacle_jump", "variations"])
def test_the_published_jumps_have_a_quick_profile_for_two_cores_and_the_published_sizes(name):
    quick, paper = (load_study(STUDIES / f"{name}.yaml", [f"profile={each}"]) for each in ("quick", "paper"))
    assert quick.resources.parallel * quick.resources.cpus <= 2
    assert quick.training["budget"]["samples"] < 100_000
    assert (paper.training["network"], paper.training["ppo"]["samples"]) == ({"hidden": [1024, 512]}, 4096)
    assert quick.name != paper.name
    assert set(quick.stages) == set(paper.stages)
