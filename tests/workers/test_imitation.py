import json
import math

import numpy as np
import pytest

from workers.checking import check_task
from workers.contracts import BadJob, BadSetting, Interrupted, Job
from workers.learning.policy import note_of
from workers.local_context import LocalContext
from workers.physics import clips, rotations
from workers.run import run
from workers.tasks.imitation import reference
from workers.tasks.imitation.env import CONTROL, Bounds, ImitationEnv
from workers.tasks.imitation.settings import SPACE, ImitationSettings, steps_at
from workers.tasks.imitation.task import LENGTH, EpisodeLength, Imitation, problem_of

TINY = {
    "budget": {"samples": 60},
    "network": {"hidden": [8]},
    "ppo": {"environments": 2, "samples": 16, "minibatch": 8, "epochs": 1},
}


def job(**changes):
    return Job(**{"study": "s", "trial": 0, "task": "imitation", "params": {}, "seed": 3,
                  "task_settings": {"episodes": 1}, "training": TINY, "z": 0.0, **changes})  # fmt: skip


@pytest.fixture(scope="module")
def walk():
    return reference.read("walk")


def test_a_cycle_goes_on_from_where_it_ends_and_another_motion_holds_its_last_pose(walk):
    clip = clips.load("walk")
    assert walk.cyclic
    later = walk.at(3 * walk.seconds + 0.4)
    now = walk.at(0.4)
    assert later.pose == pytest.approx(now.pose)
    lead = 3 * (clip.root[-1] - clip.root[0])
    assert later.root - now.root == pytest.approx([lead[0], 0.0, lead[2]])
    assert later.com - later.root == pytest.approx(now.com - now.root)
    up = reference.read("getup_facedown")
    assert not up.cyclic
    last = up.at(60.0)
    assert last.pose == pytest.approx(clips.load("getup_facedown").pose[-1], abs=1e-9)
    assert not last.rates.any()
    assert not last.velocity.any()
    assert up.upright == ()


@pytest.mark.parametrize("name", ["walk", "backflip", "spinkick"])
def test_rates_of_the_reference_lead_from_each_pose_to_the_next(name):
    found = reference.read(name)
    dt, t = 0.004, 0.31 * found.seconds
    now, then = found.at(t), found.at(t + dt)
    turn = rotations.from_rotation_vector(dt * now.rates[:24].reshape(-1, 3))
    assert rotations.angle_between(rotations.multiply(now.turns, turn), then.turns).max() < 0.02
    assert now.root + dt * now.velocity == pytest.approx(then.root, abs=0.01)
    spun = rotations.multiply(rotations.from_rotation_vector(dt * now.spin), now.orientation)
    assert float(rotations.angle_between(spun, then.orientation)) < 0.02


def test_whoever_is_where_the_reference_is_earns_a_full_reward(walk):
    env = ImitationEnv(walk)
    observation, _ = env.reset(seed=4, options={"level": 30})
    moment = walk.at(env._time)
    reward, parts, away, turned = env._reward(env.world.athlete.links(), moment)
    # the athlete may have been lifted out of the ground by millimetres
    assert reward == pytest.approx(1.0, abs=0.01)
    assert parts["pose"] == pytest.approx(1.0, abs=1e-6)
    assert away < 0.02
    assert turned < 1e-3
    assert observation.shape == (175,)
    # one knee 0.3 rad off, hand-worked: exp(-2 x 0.09)
    pose = moment.pose.copy()
    pose[24] -= 0.3
    env.world.athlete.bend(pose, moment.rates)
    _, parts, *_ = env._reward(env.world.athlete.links(), moment)
    assert parts["pose"] == pytest.approx(math.exp(-0.18), rel=1e-4)
    env.close()


@pytest.mark.parametrize("name", ["walk", "run"])
def test_targets_ahead_of_the_reference_make_up_for_the_lag_of_the_controllers(name):
    def earned(lead):
        env = ImitationEnv(reference.read(name), lead=lead)
        total = 0.0
        for seed in range(6):
            env.reset(seed=seed, options={"level": 30})
            total += sum(env.step(np.zeros(28, np.float32))[1] for _ in range(10))
        env.close()
        return total

    assert earned(0.067) > 1.1 * earned(0.0)


def test_episodes_begin_all_over_the_clip_end_at_a_fall_and_are_functions_of_their_seed(walk):
    env = ImitationEnv(walk)
    starts = []
    for seed in range(12):
        env.reset(seed=seed, options={"level": 30})
        starts.append(env._time / walk.seconds)
    assert min(starts) < 0.2
    assert max(starts) > 0.8

    def played():
        env.reset(seed=5, options={"level": 90, "fresh": True})
        rewards, over = [], False
        while not over:
            _, reward, fallen, cut, info = env.step(np.full(28, 0.3))
            rewards.append(reward)
            over = fallen or cut
        return rewards, info["success"], fallen

    first, success, fallen = played()
    assert fallen
    assert not success
    assert len(first) < 90
    assert played()[0] == first
    env.close()


@pytest.mark.parametrize("bounds", [Bounds(away=0.15), Bounds(turned=0.4)])
def test_an_episode_ends_with_the_first_step_out_of_bounds(walk, bounds):
    env = ImitationEnv(walk, bounds=bounds)
    env.reset(seed=5, options={"level": 90})
    over, inside = False, []
    while not over:
        _, _, fallen, cut, info = env.step(np.full(28, 0.3))
        links, moment = env.world.athlete.links(), walk.at(env._time)
        away = np.linalg.norm(env.world.athlete.centre_of_mass(links) - moment.com)
        turned = float(rotations.angle_between(links[0, 3:7], moment.orientation))
        inside.append(away <= bounds.away and turned <= bounds.turned)
        over = fallen or cut
    assert fallen
    assert not info["success"]
    assert len(inside) > 3
    assert inside == [True] * (len(inside) - 1) + [False]
    env.close()


def test_episodes_get_half_a_second_longer_while_fewer_than_a_fifth_fail():
    curriculum = EpisodeLength(ImitationSettings(threshold=0.8, patience=3), longest=60, start=30)
    curriculum.update([20.0] * 10, [True] * 8 + [False] * 2)
    assert curriculum.level == 30  # exactly a fifth failed
    curriculum.update([25.0] * 10, [True] * 9 + [False])
    assert curriculum.level == 45
    curriculum.update([40.0] * 4, [True] * 4)
    assert curriculum.level == 60
    assert curriculum.per_step == pytest.approx(40 / 45)
    assert not curriculum.finished()  # above the threshold, but not at full length yet
    again = EpisodeLength(ImitationSettings(threshold=0.8, patience=3), longest=60, start=30)
    again.load(json.loads(json.dumps(curriculum.state())))
    again.update([0.8 * 60], [True])
    assert again.finished()


def test_a_training_ends_after_so_many_iterations_without_gain():
    curriculum = EpisodeLength(ImitationSettings(patience=3), longest=60, start=30)
    for mean, over in ((5.0, False), (4.0, False), (5.0, False), (4.9, True)):
        curriculum.update([mean], [False])
        assert curriculum.finished() is over


def test_difficulty_is_one_to_twenty_seconds():
    assert [steps_at(z) for z in (0.0, 0.5, 1.0)] == [30, 315, 600]
    assert [steps_at(z) * CONTROL for z in (0.0, 1.0)] == [1.0, pytest.approx(20.0)]


def test_the_longest_episode_can_be_a_shorter_one():
    problem = problem_of(job(task_settings={"clip": "walk", "longest": 60}, z=1.0))
    assert problem.longest == 60
    assert problem_of(job(task_settings={"clip": "walk", "longest": 60}, z=0.5)).longest == 45


def test_the_space_is_table_6_2():
    ranges = {name.removeprefix("ppo."): (p.low, p.high) for name, p in SPACE.items()}
    assert ranges == {
        "minibatch": (32, 1024), "epochs": (1, 10), "actor_rate": (2.5e-6, 2.5e-4), "critic_rate": (1e-4, 1e-2),
        "weight_decay": (5e-4, 5e-2), "clip": (0.02, 0.2), "grad_norm": (1.0, 100.0),
    }  # fmt: skip


def test_a_trial_is_worth_its_return_per_step_less_what_it_took(tmp_path):
    context = LocalContext(tmp_path)
    mine = job(task_settings={"episodes": 1, "cost_scale": 100.0, "budget": 1.0}, params={"ppo.clip": 0.1})
    outcome = run(mine, context)
    assert outcome.status == "complete"
    per_step = outcome.details["return_per_step"]
    assert 0.05 < per_step < 0.8
    assert outcome.value == pytest.approx(per_step * math.exp(-outcome.cost.samples / 100))
    assert note_of(context.artifact("policy.safetensors"), LENGTH) >= 30
    again = Imitation().simulate(mine, context.artifact("policy.safetensors"))
    assert again.to_bytes() == context.artifact("replay.bin")
    assert again.header["frame_seconds"] == pytest.approx(1 / 30)
    assert again.header["mat_height"] == 0.0
    parent = LocalContext(tmp_path / "child", parent=tmp_path)
    parent.stop = lambda: True
    with pytest.raises(Interrupted):
        run(job(parent=0, z=0.1, training={**TINY, "budget": {"samples": 2000}}), parent)
    assert parent.reports()[0]["metrics"]["level"] == note_of(context.artifact("policy.safetensors"), LENGTH)


def test_imitation_keeps_every_promise_of_a_task():
    space = {"ppo.clip": SPACE["ppo.clip"]}
    found = check_task(Imitation(), name="imitation", settings={"episodes": 1}, space=space)
    assert [(each.check, each.verdict) for each in found] == [
        (check, "good") for check in ("settings", "spaces", "determinism", "difficulty", "resumption")
    ]


def test_every_packaged_clip_can_be_followed_for_some_steps():
    for name in reference.names():
        env = ImitationEnv(reference.read(name))
        env.reset(seed=1, options={"level": 3})
        for _ in range(3):
            observation, reward, fallen, cut, _ = env.step(np.zeros(28))
            assert np.isfinite(observation).all()
            assert 0 < reward <= 1
            if fallen or cut:
                break
        env.close()


@pytest.mark.parametrize(
    ("settings", "names", "message"),
    [
        ({"clip": "wakl"}, [], "task.settings.clip: expected a clip or the path of one, found 'wakl'; did you mean 'w"),
        ({"clip": "no/such.txt"}, [], "task.settings.clip: no/such.txt: expected a motion clip, found nothing to read"),
        ({"clips": "walk"}, [], "task.settings.clips: unknown setting; did you mean 'clip'?"),
        ({}, ["ppo.clop"], "space.ppo.clop: no setting of the learner; did you mean 'ppo.clip'"),
        ({"bound_turn": 4}, [], "task.settings.bound_turn: expected a number above 0 and at most 3.14159, found 4"),
        ({"threshold": 1.5}, [], "task.settings.threshold: expected a number above 0 and at most 1, found 1.5"),
    ],
)  # fmt: skip
def test_what_imitation_does_not_know_is_refused_by_name(settings, names, message):
    with pytest.raises(BadSetting) as refusal:
        Imitation().validate(settings, {}, names)
    assert str(refusal.value).startswith(message)


def test_a_policy_of_another_task_is_refused(tmp_path):
    from tests.workers.toy_environments import job as toy_job

    context = LocalContext(tmp_path)
    run(toy_job(training={**TINY, "budget": {"iterations": 1}}), context)
    with pytest.raises(BadJob, match="expected one of an imitation"):
        Imitation().simulate(job(), context.artifact("policy.safetensors"))
