import pytest

from workers.contracts import BadJob
from workers.learning.problem import RewardCurriculum, SuccessCurriculum


def played(curriculum, successes, episodes=20):
    curriculum.update([0.0] * episodes, [i < successes for i in range(episodes)])
    return curriculum.level


@pytest.mark.parametrize(
    ("successes", "steps"), [(0, 0), (9, 0), (10, 1), (16, 1), (17, 2), (18, 2), (19, 5), (20, 5)]
)  # fmt: skip
def test_the_level_rises_by_how_often_it_was_mastered(successes, steps):
    assert played(SuccessCurriculum(0.5, 0.01), successes) == pytest.approx(0.5 + 0.01 * steps)


def test_many_steps_do_not_add_up_rounding():
    curriculum = SuccessCurriculum(0.5, 0.01)
    for _ in range(50):
        played(curriculum, 10)
    assert curriculum.level == 1.0


def test_it_is_finished_when_the_last_level_has_been_mastered_and_not_when_it_has_been_reached():
    curriculum = SuccessCurriculum(0.5, 0.1, freeze=0.7)
    assert played(curriculum, 20) == 0.7
    assert not curriculum.finished()
    played(curriculum, 9)
    assert not curriculum.finished()
    played(curriculum, 10)
    assert curriculum.finished()
    assert curriculum.metrics() == {"level_mastered": 0.7}


def test_without_a_last_level_it_never_ends():
    curriculum = SuccessCurriculum(0.5, 0.1)
    for _ in range(100):
        played(curriculum, 20)
    assert not curriculum.finished()


def test_a_state_read_back_goes_on_as_the_one_written():
    first, second = SuccessCurriculum(0.5, 0.1, freeze=0.9), SuccessCurriculum(0.5, 0.1, freeze=0.9)
    played(first, 17)
    second.load(first.state())
    for successes in (3, 0, 0, 0, 0, 12, 20, 11):
        assert played(first, successes) == played(second, successes)
        assert first.finished() == second.finished()
        assert first.metrics() == second.metrics()


def test_where_nothing_succeeds_it_goes_back_after_three_iterations_and_never_below_the_first_level():
    curriculum = SuccessCurriculum(0.5, 0.1)
    assert played(curriculum, 20) == 1.0
    assert [played(curriculum, 0) for _ in range(6)] == pytest.approx([1.0, 1.0, 1.0, 0.9, 0.8, 0.7])
    assert played(curriculum, 1) == 0.7
    assert [played(curriculum, 0) for _ in range(4)] == pytest.approx([0.7, 0.7, 0.7, 0.6])
    assert played(curriculum, 10) == 0.7
    assert curriculum.metrics() == {"level_mastered": 0.6}
    assert [played(curriculum, 0) for _ in range(9)][-3:] == [0.5, 0.5, 0.5]
    assert curriculum.metrics() == {"level_mastered": 0.6}, "what has been mastered stays mastered"


def test_from_the_last_level_it_goes_back_at_once_however_far_the_steps_went_beyond():
    curriculum = SuccessCurriculum(0.5, 0.1, freeze=0.7)
    played(curriculum, 20)
    assert curriculum.steps == 5
    assert [played(curriculum, 0) for _ in range(5)] == pytest.approx([0.7, 0.7, 0.7, 0.6, 0.5])


def test_an_environment_without_success_is_refused():
    with pytest.raises(BadJob, match=r'curriculum: expected info\["success"\] at the end of each episode, found none'):
        SuccessCurriculum(0.5, 0.1).update([1.0, 2.0], [])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.5, 0.0), "expected a step above 0, found 0.0"),
        ((0.5, 0.1, 0.4), "expected a freeze level of at least the start level 0.5, found 0.4"),
    ],
)
def test_a_curriculum_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(BadJob, match=message):
        SuccessCurriculum(*arguments)


def test_rewards_that_add_up_raise_the_level_as_published():
    curriculum = RewardCurriculum(0.5, 0.01, freeze=0.52, threshold=30.0)
    levels = []
    for _ in range(37):
        curriculum.update([0.5, 1.2], [])
        levels.append(curriculum.level)
    # 0.85 an iteration: 36 of them come to 30.6.
    assert levels[34:] == [0.5, 0.51, 0.51]
    assert curriculum.state() == {"steps": 1, "accumulated": pytest.approx(0.85), "mastered": 0.5}
    again = RewardCurriculum(0.5, 0.01, freeze=0.52, threshold=30.0)
    again.load(curriculum.state())
    assert (again.level, again.metrics()) == (0.51, curriculum.metrics())
    for _ in range(2):
        assert not again.finished()
        again.update([30.0], [])
    assert again.level == 0.52
    again.update([30.0], [])
    assert again.finished()


@pytest.mark.parametrize(("wrong", "what"), [({"step": 0.0}, "step"), ({"threshold": 0.0}, "threshold")])
def test_a_reward_curriculum_needs_a_step_and_a_threshold(wrong, what):
    with pytest.raises(BadJob, match=f"expected a {what} above 0"):
        RewardCurriculum(**{"start": 0.5, "step": 0.01, "threshold": 30.0} | wrong)
