"""Names of jumps, and how far they are from captured ones."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from workers.physics import clips, rotations
from workers.physics.athlete import HIGH, LOW
from workers.physics.clips import BadClip
from workers.physics.kinematics import skeleton
from workers.replay import Replay
from workers.tasks.high_jump import captured
from workers.tasks.high_jump.captured import CLEARLY, LIKE, distance, likeness, mirrored, warp
from workers.tasks.high_jump.naming import landing, lead, name_jump, posture

CAPTURED = Path(__file__).parents[3] / "shared" / "mocap" / "jumps"
"""An athlete's own jumps, where they are at hand; else the packaged clips that leave the ground stand for them."""


@pytest.fixture(scope="module")
def flights():
    if CAPTURED.is_dir():
        return dict(captured.captured_jumps(CAPTURED))
    return {name: captured.flight_of_clip(clips.load(name)) for name in ("jump", "backflip", "cartwheel")}


def turned(flight, angle):
    return rotations.rotate(rotations.from_rotation_vector(np.array([0, angle, 0])), flight)


def test_forward_kinematics_is_bullets(world):
    rng = np.random.default_rng(3)
    pose, turn = rng.uniform(LOW, HIGH), rotations.from_rotation_vector(rng.normal(size=3))
    world.athlete.place([1, 2, 3], turn)
    world.athlete.bend(pose, np.zeros(28))
    links = world.athlete.links()
    found = skeleton().forward(pose, np.array([1, 2, 3]), turn)
    assert found.position == pytest.approx(links[:, :3], abs=1e-6)
    assert rotations.angle_between(found.orientation, links[:, 3:7]).max() < 1e-6
    assert skeleton().centre_of_mass(found.position) == pytest.approx(world.athlete.centre_of_mass(links), abs=1e-6)


def test_each_captured_jump_is_nearest_to_itself(flights):
    for name, flight in flights.items():
        found = {other: distance(flight, jump) for other, jump in flights.items()}
        assert found.pop(name) < 1e-6
        assert min(found.values()) > 0.2


def test_a_turned_a_mirrored_and_a_slower_jump_are_the_same_jump(flights):
    for flight in flights.values():
        assert distance(flight, turned(flight, 2.1)) < 1e-6
        assert distance(flight, mirrored(turned(flight, -0.7))) < 1e-6
        assert distance(flight, np.repeat(flight, 2, axis=0)) < 1e-6


def test_a_jump_tipped_over_is_another_jump(flights):
    flight = next(iter(flights.values()))
    tipped = rotations.rotate(rotations.from_rotation_vector(np.array([1.2, 0, 0])), flight)
    assert distance(flight, tipped) > 0.2


def test_distance_is_symmetric(flights):
    for a, b in itertools.combinations(flights.values(), 2):
        assert distance(a, b) == pytest.approx(distance(b, a), rel=1e-6)


def test_the_best_turn_is_found(flights):
    """Against a slow search over all angles."""
    a, b = list(flights.values())[:2]
    slow = []
    for image in (b, mirrored(b)):
        for angle in np.linspace(0, 2 * np.pi, 180, endpoint=False):
            other = turned(image, angle)
            cost = ((a[:, None] - other[None]) ** 2).sum((2, 3)) / 12
            slow.append(np.sqrt(warp(cost)[0] / (len(a) + len(b))))
    assert distance(a, b) == pytest.approx(min(slow), abs=2e-3)
    assert distance(a, b) <= min(slow) + 1e-9


def test_mirroring_twice_changes_nothing(flights):
    flight = next(iter(flights.values()))
    assert (mirrored(mirrored(flight)) == flight).all()


def test_the_cheapest_path_is_that_of_all_paths():
    """Against every monotone path through a small matrix."""
    cost = np.random.default_rng(0).uniform(size=(4, 5))

    def cheapest(i, j):
        if (i, j) == (0, 0):
            return 2 * cost[0, 0]
        ways = [cheapest(i - 1, j) + cost[i, j]] if i else []
        ways += [cheapest(i, j - 1) + cost[i, j]] if j else []
        ways += [cheapest(i - 1, j - 1) + 2 * cost[i, j]] if i and j else []
        return min(ways)

    total, weights = warp(cost)
    assert total == pytest.approx(cheapest(3, 4))
    assert (weights * cost).sum() == pytest.approx(total)
    assert weights.sum() == 4 + 5


def test_only_a_near_and_clearly_nearest_jump_lends_its_name():
    assert likeness({}) is None
    assert likeness({"flop": LIKE - 0.01, "straddle": LIKE + CLEARLY}).name == "flop"
    assert likeness({"flop": LIKE + 0.01}) is None
    assert likeness({"flop": 0.3, "straddle": 0.3 + CLEARLY / 2}) is None


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        ((0, 0, np.pi / 2), "face-up layout"),
        ((0, 0, -np.pi / 2), "face-down layout"),
        ((np.pi / 2, 0, 0), "layout on the right side"),
        ((-np.pi / 2, 0, 0), "layout on the left side"),
        ((0, 0, 0), "upright, facing the bar"),
        ((0, np.pi, 0), "upright, back to the bar"),
        ((0, np.pi / 2, 0), "upright, right side to the bar"),
        ((0, -np.pi / 2, 0), "upright, left side to the bar"),
        ((np.pi, 0, 0), "upside down"),
    ],
)
def test_posture_of_hand_made_orientations(turn, words):
    assert posture(rotations.from_rotation_vector(np.array(turn))) == words


def crossing(**frames):
    """A replay at 100 Hz in which each named body passes the bar at its frame."""
    names = skeleton().names
    x = np.full((100, 13, 3), -1.0, np.float32)
    for body, frame in frames.items():
        x[frame:, names.index(body), 0] = 1.0
    return Replay({"frame_seconds": 0.01}, {"position": x})


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ({"neck": 10, "left_ankle": 20, "right_ankle": 30}, "head first"),
        ({"neck": 30, "left_ankle": 10, "right_ankle": 20}, "left leg first"),
        ({"neck": 30, "left_ankle": 20, "right_ankle": 10}, "right leg first"),
        ({"neck": 30, "left_ankle": 10, "right_ankle": 14}, "feet first"),
        ({"neck": 12, "left_ankle": 10, "right_ankle": 40}, "head and left leg first"),
        ({"neck": 10, "left_ankle": 11, "right_ankle": 12}, "head and legs together"),
        ({}, ""),
    ],
)
def test_what_gets_over_first_leads(frames, words):
    assert lead(crossing(**frames)) == words


def test_a_real_jump_gets_its_words_and_its_distances(jump, flights):
    named = name_jump(jump, flights)
    assert named.name
    assert landing(jump, np.array([0, 0, 0, 1.0])) == named.landing
    assert set(named.clips) == set(flights)
    assert all(0 < metres < 2 for metres in named.clips.values())
    json.dumps(named.to_json(), allow_nan=False)


def test_without_captured_jumps_there_is_a_name_and_no_distance(jump, monkeypatch):
    monkeypatch.delenv("HALMA_CLIPS", raising=False)
    named = name_jump(jump)
    assert named.name
    assert "like" not in named.name
    assert "clips" not in named.to_json()


def test_the_folder_of_captured_jumps_is_named_by_the_environment(jump, monkeypatch, tmp_path):
    source = clips.packaged()[0].parent / "humanoid3d_jump.txt"
    (tmp_path / "X_high_jump__eastern_cut_off_03.txt").write_bytes(source.read_bytes())
    (tmp_path / "notes.txt").write_text("no clip")
    monkeypatch.setenv("HALMA_CLIPS", str(tmp_path))
    assert list(name_jump(jump).clips) == ["eastern cut off"]


def frames_of(name):
    return json.loads((clips.packaged()[0].parent / f"humanoid3d_{name}.txt").read_text())["Frames"]


def short(rows):
    rows[1] = rows[1][:43]


def stretched(rows):
    rows[2][12:16] = [value * 3 for value in rows[2][12:16]]


def word(rows):
    rows[1][5] = "one"


def infinite(rows):
    rows[1][5] = float("inf")


def no_time(rows):
    rows[0][0] = 0.0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (short, r"frame 1: expected 44 values \(duration, root, 12 joints\), found 43 values"),
        (stretched, r"frame 2: neck: expected a unit quaternion \(w x y z\), found one of length 3"),
        (word, "expected numbers only"),
        (infinite, "frame 1: expected finite numbers"),
        (no_time, "frame 0: expected a duration above 0 s, found 0"),
        (lambda rows: rows.clear(), "expected at least 2 frames, found 0"),
    ],
)
def test_a_clip_that_is_none_says_where_and_what(tmp_path, spoil, message):
    rows = frames_of("walk")
    spoil(rows)
    path = tmp_path / "walk.txt"
    path.write_text(json.dumps({"Frames": rows}))
    with pytest.raises(BadClip, match=message):
        clips.read(path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"Frames": 3}', "\x00"])
def test_what_is_no_clip_at_all_is_refused(tmp_path, text):
    path = tmp_path / "clip.txt"
    path.write_text(text)
    with pytest.raises(BadClip, match="expected"):
        clips.read(path)


def test_a_missing_clip_is_told(tmp_path):
    with pytest.raises(BadClip, match="found nothing to read"):
        clips.read(tmp_path / "nowhere.txt")


def test_all_packaged_clips_of_the_athlete_are_read():
    assert len(clips.packaged()) >= 10
    for path in clips.packaged():
        clip = clips.read(path)
        assert clip.pose.shape == (len(clip.root), 28)
        assert np.linalg.norm(clip.orientation, axis=1) == pytest.approx(1)
