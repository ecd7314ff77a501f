import json
import struct

import numpy as np
import pytest

from workers.audit import audit
from workers.contracts import BadJob
from workers.physics.limits import joint_rates
from workers.replay import ARRAYS, Replay


def doctored(replay, **changes):
    """A copy with some arrays altered in place by functions."""
    arrays = {name: array.copy() for name, array in replay.arrays.items()}
    for name, change in changes.items():
        change(arrays[name])
    return Replay(replay.header, arrays)


def test_a_replay_survives_its_file(jump):
    again = Replay.from_bytes(jump.to_bytes())
    assert again.header == jump.header
    assert {name: array.tobytes() for name, array in again.arrays.items()} == {
        name: jump.arrays[name].tobytes() for name in ARRAYS
    }
    assert again.to_bytes() == jump.to_bytes()


def test_a_reader_needs_only_the_header(jump):
    data = jump.to_bytes()
    (length,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + length])
    assert length % 4 == 0
    entry = next(e for e in header["arrays"] if e["name"] == "com")
    count = entry["shape"][0] * 3
    com = np.frombuffer(data, "<f4", count, 4 + length + entry["offset"]).reshape(-1, 3)
    assert (com == jump.arrays["com"]).all()
    assert header["bodies"][0] == "root"
    assert len(header["bodies"]) == 13
    assert header["bar"] == 0.5


def test_a_replay_is_small(jump):
    assert len(jump.to_bytes()) < 200_000


@pytest.mark.parametrize("data", [b"", b"\x05\x00\x00\x00hello", b"\xff\xff\xff\xff", b"\x02\x00\x00\x00{}"])
def test_what_is_no_replay_is_refused(data):
    with pytest.raises(BadJob, match=r"expected a replay\.bin written by halma, found something else"):
        Replay.from_bytes(data)


def test_a_replay_cut_short_is_refused(jump):
    with pytest.raises(BadJob, match=r"replay\.bin"):
        Replay.from_bytes(jump.to_bytes()[:-8])


def test_a_replay_of_another_version_says_so(jump):
    later = Replay({**jump.header, "version": 99}, jump.arrays).to_bytes()
    with pytest.raises(BadJob, match="version 1, found halma-replay version 99"):
        Replay.from_bytes(later)


def test_an_honest_jump_passes_with_numbers(jump):
    found = audit(jump)
    assert found.passed
    assert found.failures == ()
    checks = found.to_json()["checks"]
    assert set(checks) == {
        "ballistic_flight", "joint_angle", "joint_rate", "torque", "penetration", "self_intersection", "foot_push",
        "wall_touched", "missed_landing",
    }  # fmt: skip
    assert 0 < checks["ballistic_flight"]["found"] < 0.01
    assert 0.1 < checks["joint_rate"]["found"] < 1
    assert 0.5 < checks["torque"]["found"] <= 1.002


def lift(position):
    position[20:30, :, 1] += 0.1


def bend_knee(pose):
    pose[:, 24] = -3.1


def kick(pose):
    pose[20, 24] = -2.5
    pose[24, 24] = -0.1


def set_all(value):
    def change(array):
        array[:] = value

    return change


def touch_wall(touching):
    touching[10, 1] = 1


def never_land(touching):
    touching[:, 2] = 0


@pytest.mark.parametrize(
    ("array", "change", "failure"),
    [
        ("position", lift, "ballistic_flight"),
        ("pose", bend_knee, "joint_angle"),
        ("pose", kick, "joint_rate"),
        ("torque", set_all(500.0), "torque"),
        ("penetration", set_all(0.05), "penetration"),
        ("overlap", set_all(0.05), "self_intersection"),
        ("ground_force", set_all(6.1 * 45 * 9.81), "foot_push"),
        ("touching", touch_wall, "wall_touched"),
        ("touching", never_land, "missed_landing"),
    ],
)
def test_a_doctored_jump_is_refused_for_what_was_done_to_it(jump, array, change, failure):
    found = audit(doctored(jump, **{array: change}))
    assert not found.passed
    assert failure in found.failures
    if failure != "missed_landing":  # without a landing, the frames of the landing are judged too
        assert set(found.failures) - {"ballistic_flight"} <= {failure}


def test_a_jump_of_nan_is_refused_and_still_json(jump):
    found = audit(doctored(jump, position=set_all(np.nan)))
    assert "ballistic_flight" in found.failures
    json.dumps(found.to_json(), allow_nan=False)


def test_a_push_of_just_under_six_body_weights_passes(jump):
    assert audit(doctored(jump, ground_force=set_all(5.9 * 45 * 9.81))).passed


def test_rates_are_means_over_a_thirtieth_of_a_second():
    pose = np.zeros((6, 28))
    pose[:, 24] = np.arange(6) * 0.1  # a hinge at 12 rad/s
    pose[:, 2] = np.arange(6) * 0.05  # a ball about z at 6 rad/s
    rates = joint_rates(pose, 1 / 120)
    assert rates.shape == (2, 28)
    assert rates[0, 24] == pytest.approx(12)
    assert rates[0, 2] == pytest.approx(6)
