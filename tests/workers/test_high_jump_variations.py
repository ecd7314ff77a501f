"""Variations of the high jump: other gravity, and who must land on the feet."""

import numpy as np
import pytest

from workers.audit import audit
from workers.contracts import BadSetting
from workers.physics.world import Contacts, World
from workers.replay import Recorder, Replay
from workers.tasks.high_jump import HighJump
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.rules import Rules
from workers.tasks.high_jump.settings import HighJumpSettings

FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}


def push_off(**settings):
    """The jump of action 0 in flight, its verdict and its recording."""
    recorder = Recorder("right_ankle")
    env = HighJumpEnv(HighJumpSettings(formulation="flight").take_off(FLOP), recorder=recorder, **settings)
    env.reset(options={"level": 0.5})
    done = False
    while not done:
        _, _, done, _, info = env.step(np.zeros(28))
    env.close()
    return info["verdict"], recorder.replay()


@pytest.fixture(scope="module")
def on_mars():
    """Half a second of free fall from 5 m."""
    world, recorder = World(gravity=3.711), Recorder("right_ankle")
    world.athlete.place([0, 5, 0], [0, 0, 0, 1])
    recorder.start(world)
    for _ in range(60):
        recorder.add(world, world.advance())
    world.close()
    return recorder.replay()


def test_on_mars_the_centre_of_mass_falls_with_its_gravity(on_mars):
    speed = on_mars.arrays["com_velocity"][:, 1].astype(float)
    seconds = np.arange(60) * on_mars.header["frame_seconds"]
    assert np.polyfit(seconds, speed, 1)[0] == pytest.approx(-3.711, abs=0.05)


def test_on_mars_a_jump_is_judged_by_its_gravity(on_mars):
    earthly = Replay({k: v for k, v in on_mars.header.items() if k != "gravity"}, on_mars.arrays)
    assert "ballistic_flight" not in audit(on_mars).failures
    assert "ballistic_flight" in audit(earthly).failures


def test_replays_on_earth_say_nothing_of_gravity(jump):
    assert "gravity" not in jump.header


def test_who_must_land_on_the_feet_falls_on_anything_else():
    rules = Rules(foot=9, head=2, may_land_on=frozenset({9, 12}))
    assert rules.verdict(Contacts(mat={9, 12}), 1.0, 0.5) == "landed"
    assert rules.verdict(Contacts(mat={9, 1}), 1.0, 0.5) == "fall"
    assert rules.verdict(Contacts(mat={1}), 1.0, -0.5) == "fall"
    assert rules.verdict(Contacts(mat={9}), 1.0, -0.5) is None
    assert Rules(foot=9, head=2).verdict(Contacts(mat={1}), 1.0, 0.5) == "landed"


def test_a_jump_that_lands_on_the_back_is_a_fall_where_the_feet_are_asked_for(jump):
    assert push_off(landing="feet")[0] == "fall"


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"gravity": 0}, "expected a number from 0.5 to 30"), ({"landing": "head"}, "expected any or feet")],
)
def test_wrong_variations_are_refused(settings, message):
    with pytest.raises(BadSetting, match=message):
        HighJump().validate(settings, {}, ())
