"""The obstacle jump: where it begins, what counts as over, and a whole trial of a few seconds."""

import io

import numpy as np
import pytest
from PIL import Image

from workers.contracts import BadSetting, Job
from workers.local_context import LocalContext
from workers.physics.rendering import Size, render_frame, render_video
from workers.physics.world import Contacts, World
from workers.registry import load_task
from workers.replay import Replay
from workers.run import run
from workers.tasks.high_jump import ObstacleJump
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.naming import posture
from workers.tasks.high_jump.rules import Rules, rate_at
from workers.tasks.high_jump.settings import HighJumpSettings, ObstacleJumpSettings

SPIN = {"omega_x": 0.5, "omega_y": -1.0, "omega_z": 2.0}
SETTINGS = {"formulation": "flight", "rise": 4.5, "height": 0.2, "highest_width": 0.5}
TRAINING = {
    "budget": {"iterations": 2},
    "network": {"hidden": [16]},
    "ppo": {"samples": 30, "environments": 2, "minibatch": 16, "epochs": 2, "sigma_start": 0.1},
}


def job(**changes):
    values = {"task_settings": SETTINGS, "training": TRAINING, "params": SPIN} | changes
    return Job("test", 3, "obstacle_jump", seed=11, **values)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    context = LocalContext(tmp_path_factory.mktemp("trial"))
    return run(job(), context), context.folder / "artifacts"


def test_a_trial_reports_the_widest_obstacle_of_an_audited_jump(trial):
    outcome, artifacts = trial
    assert outcome.status == "complete", outcome.message
    assert outcome.value == outcome.details["width"] >= 0.3
    assert outcome.details["audit"]["passed"] is True
    assert "bar" not in outcome.details["name"]
    replay = Replay.from_bytes((artifacts / "replay.bin").read_bytes())
    assert replay.header["bar"] == pytest.approx(0.2)
    assert replay.header["wall_half_thickness"] == outcome.value / 2
    assert replay.header["task"]["name"] == "obstacle_jump"
    policy = (artifacts / "policy.safetensors").read_bytes()
    assert ObstacleJump().simulate(job(), policy).to_bytes() == replay.to_bytes()
    assert ObstacleJump().audit(job(), policy, 2).passed
    assert len(render_frame(replay, 0.3)) > 1000
    assert limbs(replay, 0.0) > 50
    assert limbs(replay, replay.seconds) > 50, "who lands is seen, not hidden by the box"


def limbs(replay, time):
    """Pixels of the right limbs in a video, which are blue."""
    video = Image.open(io.BytesIO(render_video(replay, kind="gif", slower=1.0, rate=20, size=Size(160, 120))))
    video.seek(min(round(time * 20), video.n_frames - 1))
    picture = np.asarray(video.convert("RGB")).astype(int)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    return int(((blue > red + 50) & (blue > green + 30)).sum())


def test_the_same_job_gives_the_same_weights_again(trial, tmp_path):
    again = run(job(), LocalContext(tmp_path))
    assert again.details["policy_sha256"] == trial[0].details["policy_sha256"]


def test_the_athlete_starts_before_the_obstacle_however_wide_it_is():
    settings = ObstacleJumpSettings.parse({"gap": 0.9})
    env = HighJumpEnv(settings.take_off(SPIN), obstacle=settings.obstacle, hardness=settings.hardness)
    for width in (0.05, 1.0, 2.5, 0.05):
        observation, _ = env.reset(options={"level": width})
        assert observation[0] == pytest.approx(-width / 2 - 0.9)
        assert observation[3] == width
        velocity, spin = env.world.athlete.links()[0, 7:10], env.world.athlete.links()[0, 10:13]
        assert velocity[[0, 2]] == pytest.approx([3.8, 0], abs=1e-6)
        assert spin == pytest.approx([0.5, -1.0, 2.0], abs=1e-6)
    env.close()


def test_the_obstacle_rises_while_it_is_narrow():
    heights = [ObstacleJumpSettings.parse({}).height_at(width) for width in (0.05, 0.175, 0.3, 2.5)]
    assert heights == pytest.approx([0.1, 0.3, 0.5, 0.5])
    assert [ObstacleJumpSettings.parse({"height": 0.0}).height_at(width) for width in (0.05, 1.0)] == [0, 0]


def dropped(x, width, height=0.5, frames=120):
    """What the rules say of an athlete that falls from 2.5 m at `x`."""
    world = World(mat_height=0.02)
    world.set_obstacle(height, width)
    world.athlete.place([x, 2.5, 0], [0, 0, 0, 1])
    world.athlete.links()
    rules = Rules(foot=-9, head=2, edge=width / 2)
    verdict = None
    for _ in range(frames):
        verdict = verdict or rules.verdict(world.advance(), 0.0, x)
    world.close()
    return verdict


@pytest.mark.parametrize("height", [0.5, 0.0])
@pytest.mark.parametrize(("x", "found"), [(-2.0, "ground"), (-0.6, "wall"), (0.6, "wall"), (2.0, "landed")])
def test_who_falls_before_an_obstacle_or_on_it_has_failed_and_behind_it_landed(x, found, height):
    assert dropped(x, 2.0, height) == found


def test_it_has_landed_when_its_centre_of_mass_is_behind_the_obstacle_too():
    rules = Rules(foot=9, head=2, edge=1.0)
    assert rules.verdict(Contacts(mat={9, 12}), 1.0, 0.8) is None
    assert rules.verdict(Contacts(mat={9, 12}), 1.0, 1.1) == "landed"
    assert rules.verdict(Contacts(mat={9}, wall={1}), 1.0, 1.1) == "wall"


def test_an_upright_athlete_faces_the_box():
    assert posture(np.array([0.0, 0, 0, 1]), "box") == "upright, facing the box"


def test_the_control_rate_rises_with_the_level_in_divisors_of_120():
    rates = [rate_at(bar, 10, 30) for bar in (0.2, 0.6, 0.71, 0.9, 1.1, 1.35, 1.6, 2.0)]
    assert rates == [10, 10, 12, 15, 20, 24, 30, 30]
    assert rate_at(2.0, 10, 10) == 10
    settings = HighJumpSettings.parse({"control_rate_hard": 30})
    env = HighJumpEnv(settings.take_off({}), hard_rate=30, hardness=settings.hardness)
    steps = {}
    for level in (0.5, 1.6):
        env.reset(options={"level": level})
        before = env.elapsed
        env.step(np.zeros(28))
        steps[level] = env.elapsed - before
    env.close()
    assert steps == {0.5: pytest.approx(0.1), 1.6: pytest.approx(1 / 30)}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bar_step": 0.1}, "unknown setting"),
        ({"height": -1}, "expected a number from 0 to 2"),
        ({"first_width": 1.0, "highest_width": 0.5}, "expected at least first_width, which is 1, found 0.5"),
        ({"z_freeze": 3.0}, r"expected a level from first_width, 0\.05, to highest_width, 2\.5, found 3"),
        ({"lowest_width": 0.1}, r"expected at least full_width, which is 0\.3, found 0\.1"),
        ({"control_rate": 20, "control_rate_hard": 10}, "expected at least control_rate, which is 20, found 10"),
        ({"control_rate_hard": 25}, "expected a divisor of 120"),
        ({"curriculum": "hope"}, "expected success or reward"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(BadSetting, match=message):
        load_task("obstacle_jump").validate(settings, {}, ())


def test_its_parameters_are_the_three_spins():
    with pytest.raises(BadSetting, match="alpha"):
        ObstacleJump().validate({}, {}, ["alpha"])
    assert list(ObstacleJump().info({}).parameters) == ["omega_x", "omega_y", "omega_z"]
