"""How new a behaviour is, and trainings that are to find something new or to go on with a policy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from search import Features
from search.novelty import Archive
from workers.contracts import BadJob, FeatureSpec, Job
from workers.learning.policy import Policy
from workers.local_context import LocalContext
from workers.novelty import Novelty
from workers.replay import Replay
from workers.run import run
from workers.tasks.high_jump import behaviour
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.settings import HighJumpSettings
from workers.tasks.high_jump.task import JumpProblem, with_bar

FACING = behaviour.FEATURES["facing"]
CIRCLE = FeatureSpec("circle", ("angle",), distinct=0.5)
ROTATION = behaviour.FEATURES["rotation"]
FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}
SETTINGS = {"formulation": "flight", "first_bar": 0.45, "lowest_bar": 0.45, "highest_bar": 0.6, "bar_step": 0.05}
TRAINING = {
    "budget": {"iterations": 1},
    "network": {"hidden": [16]},
    "ppo": {"samples": 30, "environments": 2, "minibatch": 16, "epochs": 2, "sigma_start": 0.1},
}


def job(novelty=None, **changes):
    values = {"task_settings": SETTINGS, "training": TRAINING, "params": FLOP} | changes
    return Job("test", 3, "high_jump", seed=11, novelty=novelty, **values)


def unit(values):
    q = np.array(values)
    return q / np.linalg.norm(q)


numbers = st.floats(-3, 3, allow_nan=False)
quaternions = st.tuples(*[st.floats(0.1, 1)] * 4).map(unit)


@given(st.lists(numbers, min_size=1, max_size=4), numbers, st.floats(0.1, 3))
def test_the_factor_of_a_training_is_the_search_s_own_equation_12(known, y, threshold):
    for spec, features in ((FACING, Features.euclidean(1)), (CIRCLE, Features.circle())):
        mine = Novelty.of(job({"avoid": [[k] for k in known], "threshold": threshold}), spec)
        archive = Archive(features, np.array(known)[:, None], np.zeros(len(known)))
        expected = archive.novelty_reward(np.array([[y]]), threshold)[0]
        assert mine.factor((y,)) == pytest.approx(expected, abs=1e-9)


@given(st.lists(quaternions, min_size=1, max_size=3), quaternions)
def test_the_factor_of_a_rotation_is_the_search_s_own_too(known, q):
    mine = Novelty.of(job({"avoid": [k.tolist() for k in known], "threshold": 1.5}), ROTATION)
    archive = Archive(Features.rotation(), np.array(known), np.zeros(len(known)))
    assert mine.factor(tuple(-q)) == pytest.approx(archive.novelty_reward(q[None], 1.5)[0], abs=1e-7)


def test_where_nothing_is_known_everything_is_new():
    novelty = Novelty.of(job({"avoid": [], "threshold": 1.5}), FACING)
    assert (novelty.factor((0.3,)), novelty.is_new((0.3,))) == (1.0, True)


def test_new_is_what_is_far_from_all_that_stand_for_a_strategy_however_near_another_known_one_is():
    away = {"avoid": [[1.0], [1.35], [2.6]], "strategies": [[1.0], [2.6]], "threshold": 1.5}
    novelty = Novelty.of(job(away), FACING)
    assert novelty.is_new((1.45,)), "1.35 belongs to the strategy of 1.0, from which this is further than 0.4 rad"
    assert not novelty.is_new((1.39,))
    assert not novelty.is_new((2.3,))
    assert novelty.factor((1.45,)) == pytest.approx(0.1 / 1.5), "the reward sees every policy, as equation 12 does"
    told_of_none = Novelty.of(job({"avoid": away["avoid"], "threshold": 1.5}), FACING)
    assert not told_of_none.is_new((1.45,))
    with pytest.raises(BadJob, match=r"novelty\.strategies: expected behaviours of 1 numbers"):
        Novelty.of(job(away | {"strategies": ["x"]}), FACING)


@pytest.mark.parametrize(
    ("novelty", "message"),
    [
        ({"avoid": [[0.1]], "threshold": 0}, "novelty.threshold: expected a number above 0, found 0"),
        ({"avoid": [[0.1, float("nan")]], "threshold": 1.0}, "novelty.avoid: expected behaviours of 1 numbers"),
        ({"avoid": ["x"], "threshold": 1.0}, "novelty.avoid: expected behaviours of 1 numbers"),
    ],
)
def test_what_makes_no_sense_to_keep_away_from_is_refused(novelty, message):
    with pytest.raises(BadJob, match=message):
        Novelty.of(job(novelty), FACING)


def jump(novelty):
    """The jump of action 0 in flight."""
    env = HighJumpEnv(HighJumpSettings(formulation="flight").take_off(FLOP), novelty=novelty)
    env.reset(options={"level": 0.45})
    done = False
    while not done:
        _, reward, done, _, info = env.step(np.zeros(28))
    env.close()
    return reward, info


@pytest.fixture(scope="module")
def plain():
    """What the jump earns without novelty, and how it faces: both as the training's recording tells."""
    reward, info = jump(None)
    assert info["success"]
    return reward


def test_the_reward_of_a_jump_is_multiplied_by_how_new_it_is(plain, tmp_path):
    outcome = run(job(), LocalContext(tmp_path))
    facing = outcome.details["facing"]
    reward, info = jump(Novelty(FACING, np.array([[facing + 0.3]]), 1.5))
    assert "novelty" not in jump(None)[1]["metrics"]
    factor = info["metrics"]["novelty"]
    assert reward == pytest.approx(plain * factor)
    # The trained jump and that of action 0 are not the same, but near each other.
    assert 0.01 < factor < 0.5
    assert info["success"] is False, "as far from a known one as this, it is no other strategy"
    assert jump(Novelty(FACING, np.array([[facing + 1.5]]), 1.5))[1]["success"] is True


def test_the_passing_is_the_recording_s():
    rng = np.random.default_rng(3)
    x = np.linspace(-0.5, 0.4, 10)
    turned = rng.normal(size=(10, 1, 4))
    turned /= np.linalg.norm(turned, axis=2, keepdims=True)

    recording = Replay({"frame_seconds": 0.1}, {"com": np.stack([x, x, x], 1), "orientation": turned})

    watch = behaviour.Passing()
    for at, q in zip(x, turned[:, 0], strict=True):
        if watch.orientation is None:
            watch.look(float(at), q)
    expected = behaviour.over_the_bar(recording)[1]
    assert np.allclose(watch.orientation, expected)


def test_a_trained_novelty_is_judged_like_any_other_jump(tmp_path):
    outcome = run(job({"avoid": [[3.0]], "threshold": 1.5}), LocalContext(tmp_path))
    assert outcome.status == "complete"
    assert outcome.details["audit"]["passed"]


def start(cleared, novelty=None, **settings):
    parsed = HighJumpSettings.parse({"first_bar": 0.2, "bar_step": 0.02, "highest_bar": 1.0} | settings)
    return JumpProblem(parsed, parsed.take_off(FLOP), novelty, cleared).curriculum().level


def test_a_training_that_goes_on_begins_a_little_below_what_is_cleared():
    assert start(None) == 0.2
    assert start(0.84) == pytest.approx(0.74)
    assert start(0.25) == 0.2
    assert start(2.0) == 1.0
    assert start(0.84, Novelty(FACING, np.zeros((1, 1)), 1.0)) == 0.2, "a new jump is learnt like the first"


def test_the_search_ends_at_z_freeze_and_a_polish_goes_beyond():
    frozen = HighJumpSettings.parse({"z_freeze": 1.0})
    assert JumpProblem(frozen, frozen.take_off(FLOP)).curriculum().freeze == 1.0
    polish = HighJumpSettings.parse({})
    assert JumpProblem(polish, polish.take_off(FLOP)).curriculum().freeze == 2.5
    with pytest.raises(BadJob, match=r"expected a level from first_bar, 0\.2, to highest_bar, 2\.5, found 2\.6"):
        HighJumpSettings.parse({"z_freeze": 2.6})


class WithParent(LocalContext):
    """A context whose parent left a policy that clears 0.55 m."""

    policy = b""

    def parent_artifact(self, name):
        return self.policy


def test_a_polish_starts_from_its_parents_bar(tmp_path):
    first = LocalContext(tmp_path / "a")
    run(job(), first)
    policy = (first.folder / "artifacts" / "policy.safetensors").read_bytes()
    assert Policy.from_bytes(policy)
    second = WithParent(tmp_path / "b")
    second.policy = with_bar(policy, 0.62)
    outcome = run(job(parent=0), second)
    assert outcome.details["warm_start"]["networks"] is True
    assert second.reports()[0]["metrics"]["level"] == pytest.approx(0.5)
