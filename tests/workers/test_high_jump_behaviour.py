import numpy as np
import pytest

from workers.physics.rotations import from_rotation_vector
from workers.replay import Replay
from workers.tasks.high_jump import behaviour


@pytest.mark.parametrize(
    ("turn", "degrees"),
    [
        ((0, 0, 0), 90),  # upright
        ((0, 0, np.pi / 2), 0),  # on the back, face up
        ((0, 0, -np.pi / 2), 180),  # face down
        ((np.pi / 2, 0, 0), 90),  # on the side
        ((0, 2.5, 0), 90),  # upright, turned about itself
        ((0, 0, np.pi / 6), 60),  # leaning back
    ],
)
def test_facing_of_hand_made_orientations(turn, degrees):
    assert behaviour.facing(from_rotation_vector(np.array(turn))) == pytest.approx(np.radians(degrees), abs=1e-7)


def passing(x, turns):
    """A replay with this path of the centre of mass along x, the root turned so about z."""
    com = np.zeros((len(x), 3), np.float32)
    com[:, 0] = x
    orientation = np.zeros((len(x), 13, 4), np.float32)
    orientation[:, 0] = from_rotation_vector(np.array([[0, 0, t] for t in turns]))
    return Replay({"frame_seconds": 0.1}, {"com": com, "orientation": orientation})


def test_the_orientation_is_taken_where_the_centre_of_mass_passes_the_plane():
    time, q = behaviour.over_the_bar(passing([-0.5, -0.3, 0.1, 0.5], [0, 0.2, 0.6, 0.9]))
    # three quarters of the way from frame 1 to frame 2
    assert time == pytest.approx(0.175)
    assert q == pytest.approx(from_rotation_vector(np.array([0, 0, 0.5])), abs=1e-6)
    assert behaviour.facing(q) == pytest.approx(np.pi / 2 - 0.5, abs=1e-6)


def test_the_quaternion_has_a_positive_w_and_unit_length():
    _, q = behaviour.over_the_bar(passing([-0.1, 0.1], [4.0, 4.2]))
    assert q[3] >= 0
    assert np.linalg.norm(q) == pytest.approx(1)


def test_who_never_passes_the_bar_has_no_behaviour():
    assert behaviour.over_the_bar(passing([-0.5, -0.2, -0.1], [0, 0, 0])) is None


def test_the_features_of_a_real_jump(jump):
    time, q = behaviour.over_the_bar(jump)
    assert 0.2 < time < 0.6
    assert 0 <= behaviour.facing(q) <= np.pi
