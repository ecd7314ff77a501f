import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workers.physics import rotations

vectors = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))


def test_a_quarter_turn_about_y_takes_forward_to_the_left():
    q = rotations.from_rotation_vector(np.array([0, np.pi / 2, 0]))
    assert q == pytest.approx([0, np.sqrt(0.5), 0, np.sqrt(0.5)])
    assert rotations.rotate(q, np.array([1.0, 0, 0])) == pytest.approx([0, 0, -1])


def test_the_product_turns_by_its_second_factor_first():
    about_z = rotations.from_rotation_vector(np.array([0, 0, np.pi / 2]))
    about_x = rotations.from_rotation_vector(np.array([np.pi / 2, 0, 0]))
    # x -> y about z, then y -> z about x
    assert rotations.rotate(rotations.multiply(about_x, about_z), np.array([1.0, 0, 0])) == pytest.approx([0, 0, 1])


@given(vectors)
def test_rotation_vector_and_quaternion_are_inverse(e):
    assert rotations.to_rotation_vector(rotations.from_rotation_vector(e)) == pytest.approx(e, abs=1e-6)


@given(vectors, vectors)
def test_a_rotation_keeps_lengths_and_its_conjugate_undoes_it(e, v):
    q = rotations.from_rotation_vector(e)
    turned = rotations.rotate(q, v)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(v), abs=1e-12)
    assert rotations.rotate(rotations.conjugate(q), turned) == pytest.approx(v, abs=1e-12)


@given(vectors, vectors)
def test_q_and_minus_q_are_the_same_rotation(e, f):
    a, b = rotations.from_rotation_vector(e), rotations.from_rotation_vector(f)
    assert rotations.angle_between(a, b) == pytest.approx(rotations.angle_between(-a, b), abs=1e-6)
    assert rotations.angle_between(a, -a) == pytest.approx(0, abs=1e-6)


def test_interpolation_goes_the_short_way_at_constant_speed():
    a = rotations.from_rotation_vector(np.array([0, 0, 0.2]))
    b = -rotations.from_rotation_vector(np.array([0, 0, 1.0]))
    middle = rotations.interpolate(a, b, 0.25)
    assert rotations.to_rotation_vector(middle) == pytest.approx([0, 0, 0.4])


def test_functions_broadcast_over_leading_axes():
    e = np.random.default_rng(0).normal(size=(2, 3, 3))
    q = rotations.from_rotation_vector(e)
    assert q.shape == (2, 3, 4)
    assert rotations.rotate(q, e) == pytest.approx(e)  # an axis is not moved by its own rotation
