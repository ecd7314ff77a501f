import io
import math

import numpy as np
import pytest
from PIL import Image

from tests.workers.toy_environments import job as toy_job
from workers.checking import check_task
from workers.contracts import BadJob, BadSetting, Interrupted, Job
from workers.learning.policy import note_of, with_note
from workers.local_context import LocalContext
from workers.physics.rendering import render_frame
from workers.run import run
from workers.tasks.walker.body import DENSITY, HINGES, PARAMETERS, PARTS, Solid, figure
from workers.tasks.walker.env import WalkerEnv
from workers.tasks.walker.task import LEVEL, Walker, Withdrawal
from workers.tasks.walker.world import CONTROL, GAIN, WalkerWorld

SHORT = {"steps": 12, "training_steps": 8, "episodes": 1}
TINY = {
    "budget": {"samples": 60},
    "network": {"hidden": [8]},
    "ppo": {"environments": 2, "samples": 16, "minibatch": 8, "epochs": 1},
}
SMALLEST = {name: parameter.low for name, parameter in PARAMETERS.items()}
LARGEST = {name: parameter.high for name, parameter in PARAMETERS.items()}


def job(**changes):
    return Job(**{"study": "s", "trial": 0, "task": "walker", "params": {}, "seed": 3, "task_settings": SHORT,
                  "training": TINY, "z": 1.0, **changes})  # fmt: skip


@pytest.fixture
def world():
    made = WalkerWorld(figure({}), speed=1.0)
    yield made
    made.close()


def test_twelve_factors_of_six_parts_move_fifteen_hinges():
    assert len(PARAMETERS) == 12
    assert {name.split("_")[0] for name in PARAMETERS} == set(PARTS)
    assert {(p.low, p.high) for name, p in PARAMETERS.items() if name.endswith("length")} == {(0.3, 2.0)}
    assert {(p.low, p.high) for name, p in PARAMETERS.items() if name.endswith("radius")} == {(0.5, 1.5)}
    assert len(HINGES) == 15


@pytest.mark.parametrize("solid", [
    Solid("capsule", (0.1, 0.3), "y", (0.0, 0.0, 0.0)),
    Solid("capsule", (0.05, 0.2), "z", (0.0, 0.0, 0.0)),
    Solid("box", (0.2, 0.08, 0.104), "z", (0.0, 0.0, 0.0)),
])  # fmt: skip
def test_masses_and_moments_are_those_of_the_volume_cut_into_small_cubes(solid):
    edge = 0.004
    axis = np.arange(-0.26 + edge / 2, 0.26, edge)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    if solid.shape == "box":
        inside = np.all([np.abs(c) < s / 2 for c, s in zip((x, y, z), solid.size, strict=True)], axis=0)
    else:
        r, length = solid.size
        along = {"x": x, "y": y, "z": z}[solid.axis]
        beyond = np.maximum(np.abs(along) - length / 2, 0.0)
        inside = x**2 + y**2 + z**2 - along**2 + beyond**2 < r * r
    dm = DENSITY * edge**3
    assert solid.mass == pytest.approx(dm * inside.sum(), rel=0.02)
    moments = [dm * (a**2 + b**2)[inside].sum() for a, b in ((y, z), (x, z), (x, y))]
    assert solid.inertia == pytest.approx(moments, rel=0.03)


def test_bullet_has_the_masses_of_the_volumes_and_the_walker_stands_on_its_soles(world):
    import pybullet

    count = pybullet.getNumJoints(world.body, **world._k)
    assert count == 15
    masses = [pybullet.getDynamicsInfo(world.body, link, **world._k)[0] for link in range(-1, count)]
    assert sum(masses) == pytest.approx(world.figure.mass, rel=1e-6)
    # twice as long in every part and half as thick again: hand-worked for the torso, pi r^2 (l + 4 r / 3)
    assert figure(LARGEST).bodies[0].solid.mass == pytest.approx(1000 * math.pi * 0.195**2 * (0.6 + 0.26))
    world.place(np.zeros(15), [0.0, world.figure.height, 0.0])
    links = world.links()
    soles = [links[i, 1] - world.figure.bodies[i].solid.size[1] / 2 for i in (5, 8)]
    assert [world.figure.bodies[i].name for i in (5, 8)] == ["right_foot", "left_foot"]
    assert soles == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("params", [SMALLEST, {}, LARGEST], ids=["smallest", "plain", "largest"])
def test_torques_within_the_body_leave_the_centre_of_mass_to_gravity(params):
    world = WalkerWorld(figure(params), speed=1.0)
    world.place(np.zeros(15), [0.0, world.figure.height + 3.0, 0.0])
    share = np.array([b.solid.mass for b in world.figure.bodies]) / world.figure.mass
    start = share @ world.links()[:, :3]
    rng = np.random.default_rng(0)
    for _ in range(12):
        world.advance(rng.uniform(-15, 15, 15))
    t = 12 * CONTROL
    end = share @ world.links()[:, :3]
    world.close()
    # Semi-implicit steps of 1/240 s fall 9.81 t / 480 further than the parabola
    assert end - start == pytest.approx([0.0, -9.81 * t * (t + 1 / 240) / 2, 0.0], abs=0.01)


@pytest.mark.parametrize("params", [{}, LARGEST, {"torso_radius": 0.5}], ids=["plain", "largest", "thin torso"])
def test_the_helping_hand_pushes_with_its_gains_for_the_speed_that_the_torso_will_have(params):
    world = WalkerWorld(figure(params), speed=1.0)
    share = np.array([b.solid.mass for b in world.figure.bodies]) / world.figure.mass

    def after_one_step(level):
        """Of the whole body and of the torso, without what falling adds, m/s."""
        world.rebuild()
        world.place(np.zeros(15), [0.0, world.figure.height + 1.0, 0.3])
        world.level = level
        world.advance(np.zeros(15))
        velocity = world.links()[:, 7:10] + np.array([0.0, 9.81 * CONTROL, 0.0])
        return share @ velocity, velocity[0]

    target = np.array([1.0, -1.0, -0.3])  # 1 m/s ahead, 1 m too high, 0.3 m aside
    for level in (0.0, 0.5, 0.9, 0.99):
        body, torso = after_one_step(level)
        gain = GAIN * (1 - level)
        assert body == pytest.approx(gain * CONTROL * (target - torso), rel=0.3, abs=0.02)
        assert np.all(np.abs(torso) < np.abs(target))  # it is never thrown beyond
    # hardly any help: explicit control would be the same
    assert body == pytest.approx(gain * CONTROL * target, rel=0.2, abs=0.003)
    assert after_one_step(1.0)[0] == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
    world.close()


def stays_up(params, level):
    """Whether the walker is up after 5 s without any muscle, and has got as far as the hand shall lead it."""
    env = WalkerEnv(figure(params), steps=300)
    env.reset(seed=1, options={"level": level})
    up = not any(env.step(np.zeros(15))[2] for _ in range(300))
    x = env.world.root()[0][0]
    env.close()
    return up and x == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_the_hand_throws_hardly_any_body_of_the_space_down(level):
    rng = np.random.default_rng(0)
    drawn = [{name: float(rng.uniform(p.low, p.high)) for name, p in PARAMETERS.items()} for _ in range(20)]
    assert stays_up({}, level)
    assert stays_up(LARGEST, level)
    assert sum(stays_up(params, level) for params in drawn) >= 18


@pytest.mark.parametrize("params", [SMALLEST, {}, LARGEST], ids=["smallest", "plain", "largest"])
def test_with_whole_help_any_walker_stays_up_and_alone_it_falls(params):
    env = WalkerEnv(figure(params), steps=150)
    lengths = {}
    for level in (0.3, 1.0):
        env.reset(seed=1, options={"level": level})
        lengths[level], over, total = 0, False, 0.0
        while not over:
            _, reward, fallen, cut, info = env.step(np.zeros(15))
            lengths[level] += 1
            total += reward
            over = fallen or cut
        assert info["success"] is not fallen
    env.close()
    assert lengths[0.3] == 150
    assert lengths[1.0] < 150


def test_the_walker_keeps_every_promise_of_a_task():
    found = check_task(Walker(), name="walker", settings=SHORT)
    assert [(each.check, each.verdict) for each in found] == [
        (check, "good") for check in ("settings", "spaces", "determinism", "difficulty", "resumption")
    ]
    difficulty = found[3].found
    assert "50,000 at z = 0" in difficulty
    assert "200,000 at z = 1" in difficulty


def test_help_is_withdrawn_by_success_and_at_the_latest_by_the_deadline():
    quick = Withdrawal(0.0, 0.1, 0.8, 10)
    quick.update([1.0], [True])
    assert quick.level == 0.5  # all stayed up: five steps
    quick.update([1.0], [True])
    assert quick.level == 0.8  # and never beyond the difficulty
    slow = Withdrawal(0.4, 0.1, 0.8, 4)
    levels = []
    for _ in range(6):
        slow.update([1.0], [False])
        levels.append(slow.level)
    assert levels == pytest.approx([0.5, 0.6, 0.7, 0.8, 0.8, 0.8])
    assert not slow.finished()
    again = Withdrawal(0.0, 0.1, 0.8, 4)
    again.load(slow.state())
    assert (again.level, again.start, again.iterations) == (0.8, 0.4, 6)


def test_a_walk_is_kept_and_simulated_again_bit_for_bit(tmp_path):
    context = LocalContext(tmp_path)
    outcome = run(job(params={"thigh_length": 1.2}), context)
    assert outcome.status == "complete"
    assert outcome.details["level"] == 1.0
    replay = context.artifact("replay.bin")
    again = Walker().simulate(job(params={"thigh_length": 1.2}), context.artifact("policy.safetensors"))
    assert again.to_bytes() == replay
    assert again.header["bodies"][0] == "torso"
    assert again.arrays["position"].shape[1:] == (9, 3)
    assert again.arrays["com"][0, 1] > 0.7
    picture = render_frame(again, 0.0)
    colours = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), np.int64)
    # the orange left leg is drawn, in the middle of the picture
    orange = np.argwhere((colours[..., 0] > 150) & (colours[..., 2] < 70) & (colours[..., 1] > 70))
    assert len(orange) > 200
    assert abs(orange[:, 1].mean() - colours.shape[1] / 2) < 60


def test_a_child_goes_on_from_the_help_its_parent_had_left_even_when_the_parent_is_gone(tmp_path):
    parent = LocalContext(tmp_path / "parent")
    run(job(z=0.6), parent)
    assert note_of(parent.artifact("policy.safetensors"), LEVEL) == 0.6
    child = LocalContext(tmp_path / "child", parent=tmp_path / "parent")
    child.stop = lambda: len(child.reports()) == 1
    with pytest.raises(Interrupted):
        run(job(z=0.9, parent=0), child)
    assert child.reports()[0]["metrics"]["level"] == 0.6
    assert child.load_checkpoint().state["curriculum"]["start"] == 0.6
    outcome = run(job(z=0.9, parent=0), LocalContext(tmp_path / "child"))
    assert outcome.status == "complete"
    assert outcome.details["warm_start"]["parent"] == 0


def test_a_policy_of_another_task_is_no_parent_of_a_walker(tmp_path):
    parent = LocalContext(tmp_path / "parent")
    run(toy_job(training={**TINY, "budget": {"iterations": 1}}), parent)
    outcome = run(job(parent=0), LocalContext(tmp_path / "child", parent=tmp_path / "parent"))
    assert outcome.status == "failed"
    assert "expected a policy of 46 observations and continuous actions of size 15, found" in outcome.message
    with pytest.raises(BadJob, match="expected one of a walker"):
        Walker().simulate(job(), parent.artifact("policy.safetensors"))


def test_a_note_in_a_policy_changes_nothing_else(tmp_path):
    from workers.learning.policy import Policy

    context = LocalContext(tmp_path)
    run(job(), context)
    plain = context.artifact("policy.safetensors")
    noted = with_note(plain, "mine", 2.5)
    assert note_of(noted, "mine") == 2.5
    assert note_of(noted, "other") is None
    assert Policy.from_bytes(noted).sha256() == Policy.from_bytes(plain).sha256()


@pytest.mark.parametrize(
    ("settings", "names", "message"),
    [
        ({"step": 3}, [], "task.settings.step: unknown setting; did you mean 'steps'?"),
        ({"budget": 0.0}, [], "task.settings.budget: expected a number above 0"),
        ({}, ["shin_length"], "space.shin_length: unknown setting"),
    ],
)
def test_what_the_walker_does_not_know_is_refused_by_name(settings, names, message):
    with pytest.raises(BadSetting, match=f"^{message.replace('?', '.')}"):
        Walker().validate(settings, {}, names)


def test_the_floor_carries_the_whole_weight_of_a_walker_that_stands(world):
    world.place(np.zeros(15), [0.0, world.figure.height, 0.0])
    for _ in range(10):
        world.advance(np.zeros(15))
    force, point = world.contacts()
    assert force[:, 1].sum() == pytest.approx(9.81 * world.figure.mass, rel=0.01)
    assert np.flatnonzero(force[:, 1]).tolist() == [5, 8]
    assert point[[5, 8], 1] == pytest.approx([0.0, 0.0], abs=0.01)
