import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from search import BadFeatures, Features, cluster_joined, distinct


def test_hand_worked_distances():
    circle, rotation = Features.circle(), Features.rotation()
    assert circle.distance(np.array([3.0]), np.array([-3.0])) == pytest.approx(2 * math.pi - 6)
    assert circle.distance(np.array([0.0]), np.array([math.pi])) == pytest.approx(math.pi)
    quarter = np.array([math.sin(math.pi / 4), 0, 0, math.cos(math.pi / 4)])
    assert rotation.distance(quarter, np.array([0, 0, 0, 1.0])) == pytest.approx(math.pi / 2)
    assert rotation.distance(quarter, -quarter) == pytest.approx(0)
    plane = Features.euclidean(2, low=-1, high=[1, 2])
    assert plane.distance(np.array([0, 0.0]), np.array([3, 4.0])) == pytest.approx(5)
    assert plane.diameter == pytest.approx(math.hypot(2, 3))


@given(st.integers(0, 2**32 - 1))
def test_rotation_distance_is_the_angle_of_the_relative_rotation_matrix(seed):
    a, b = Rotation.random(2, rng=np.random.default_rng(seed))
    relative = a.as_matrix().T @ b.as_matrix()
    angle = math.acos(min(1, max(-1, (np.trace(relative) - 1) / 2)))
    assert Features.rotation().distance(a.as_quat(), b.as_quat()) == pytest.approx(angle, abs=1e-6)


@given(st.lists(st.floats(-20, 20), min_size=3, max_size=3), st.integers(-3, 3))
def test_circle_distance_is_a_metric_and_ignores_full_turns(angles, turns):
    circle = Features.circle()
    a, b, c = (np.array([x]) for x in angles)
    assert circle.distance(a, b) == pytest.approx(circle.distance(b, a), abs=1e-12)
    assert circle.distance(a + turns * 2 * math.pi, b) == pytest.approx(circle.distance(a, b), abs=1e-9)
    assert circle.distance(a, c) <= circle.distance(a, b) + circle.distance(b, c) + 1e-9
    assert 0 <= circle.distance(a, b) <= math.pi


@pytest.mark.parametrize(
    ("metric", "features", "message"),
    [
        (Features.circle(), [1.0, 2.0], "expected 1 numbers as circle features, found 2"),
        (Features.circle(), [math.nan], "expected finite circle features, found [nan]"),
        (Features.circle(), "left", "expected 1 numbers as circle features, found 'left'"),
        (Features.rotation(), [1, 1, 0, 0], "expected a unit quaternion (x, y, z, w), found norm 1.41421"),
        (Features.rotation(), [0, 0, 1], "expected 4 numbers as rotation features, found 3"),
    ],
)
def test_a_wrong_behaviour_says_what_was_expected_and_found(metric, features, message):
    with pytest.raises(BadFeatures) as caught:
        metric.check(features)
    assert message in str(caught.value)


def test_a_wrong_feature_space_is_refused():
    with pytest.raises(BadFeatures, match="expected 2 values for low, found 3"):
        Features.euclidean(2, low=[0, 0, 0])
    with pytest.raises(BadFeatures, match="expected low < high for coordinate 0"):
        Features.euclidean(1, low=1, high=1)
    with pytest.raises(BadFeatures, match="expected d >= 1, found 0"):
        Features.euclidean(0)


def test_hand_worked_clusters_on_the_circle():
    angles = [[0.0], [0.2], [3.1], [-3.1], [1.5]]
    clusters = distinct(angles, [1.0, 2.0, 0.5, 0.7, 0.1], Features.circle(), 0.3)
    assert [(c.representative, c.members) for c in clusters] == [(1, (0, 1)), (3, (2, 3)), (4, (4,))]


angles = st.floats(-3.1, 3.1).map(lambda x: round(x, 6))
outcomes = st.lists(st.tuples(angles, st.floats(-5, 5)), min_size=1, max_size=30, unique=True)


@given(outcomes, st.floats(0.01, 2), st.randoms(use_true_random=False))
def test_clusters_do_not_depend_on_the_order_of_outcomes(pairs, threshold, random):
    shuffled = list(pairs)
    random.shuffle(shuffled)
    found = [
        {
            frozenset(order[i] for i in c.members): order[c.representative]
            for c in distinct([[a] for a, _ in order], [v for _, v in order], Features.circle(), threshold)
        }
        for order in (pairs, shuffled)
    ]
    assert found[0] == found[1]


@given(outcomes, st.floats(0.01, 2))
def test_representatives_are_apart_lead_their_members_and_cover_all(pairs, threshold):
    metric = Features.circle()
    Y, values = np.array([[a] for a, _ in pairs]), [v for _, v in pairs]
    clusters = distinct(Y, values, metric, threshold)
    assert sorted(i for c in clusters for i in c.members) == list(range(len(pairs)))
    for c in clusters:
        assert max(values[i] for i in c.members) == values[c.representative]
        assert all(metric.distance(Y[i], Y[c.representative]) <= threshold for i in c.members)
    for i, a in enumerate(clusters):
        for b in clusters[:i]:
            assert metric.distance(Y[a.representative], Y[b.representative]) > threshold


def test_nothing_has_no_clusters_and_wrong_shapes_are_refused():
    assert distinct([], [], Features.circle(), 0.1) == []
    with pytest.raises(BadFeatures, match="one value for each of the 2 behaviours, found 1"):
        distinct([[0.0], [1.0]], [1.0], Features.circle(), 0.1)
    with pytest.raises(BadFeatures, match="threshold of at least 0, found -1"):
        distinct([[0.0]], [1.0], Features.circle(), -1)


@given(outcomes, st.floats(0.01, 2))
def test_clusters_agree_with_a_slow_obvious_version(pairs, threshold):
    left = sorted(range(len(pairs)), key=lambda i: (-pairs[i][1], pairs[i][0]))
    slow = []
    while left:
        leader = pairs[left[0]][0]
        gaps = {i: abs(math.remainder(pairs[i][0] - leader, 2 * math.pi)) for i in left}
        slow.append((left[0], tuple(sorted(i for i in left if gaps[i] <= threshold))))
        left = [i for i in left if gaps[i] > threshold]
    found = distinct([[a] for a, _ in pairs], [v for _, v in pairs], Features.circle(), threshold)
    near_the_threshold = any(
        abs(abs(math.remainder(a - b, 2 * math.pi)) - threshold) < 1e-9 for a, _ in pairs for b, _ in pairs
    )
    assert near_the_threshold or [(c.representative, c.members) for c in found] == slow


@given(outcomes, st.floats(0.01, 2))
def test_one_more_outcome_joins_the_cluster_that_grouping_all_anew_puts_it_in(pairs, threshold):
    metric = Features.circle()
    Y, values = [[a] for a, _ in pairs], [v for _, v in pairs]
    before = distinct(Y[:-1], values[:-1], metric, threshold)
    after = distinct(Y, values, metric, threshold)
    place = cluster_joined(
        Y[-1],
        values[-1],
        [Y[c.representative] for c in before],
        [values[c.representative] for c in before],
        metric,
        threshold,
    )
    last = len(pairs) - 1
    if place is None:
        assert last in [c.representative for c in after]
    else:
        grown = [(c.representative, c.members + ((last,) if i == place else ())) for i, c in enumerate(before)]
        assert [(c.representative, c.members) for c in after] == grown


def test_of_two_equal_outcomes_the_earlier_one_leads_and_a_better_one_leads_itself():
    circle = Features.circle()
    assert cluster_joined([0.0], 1.0, [[0.0], [2.0]], [1.0, 0.5], circle, 0.3) == 0
    # Just as good, and before it in the order of features.
    assert cluster_joined([-0.1], 1.0, [[0.0], [2.0]], [1.0, 0.5], circle, 0.3) is None
    assert cluster_joined([2.1], 0.6, [[0.0], [2.0]], [1.0, 0.5], circle, 0.3) is None
    assert cluster_joined([2.1], float("nan"), [[0.0], [2.0]], [1.0, 0.5], circle, 0.3) == 1
