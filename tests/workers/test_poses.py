"""The pose autoencoder: what it sees, what it learns, and what it refuses."""

import json

import numpy as np
import pytest
from safetensors.numpy import load, save
from scipy.spatial.transform import Rotation

from workers.contracts import BadJob, BadSetting
from workers.physics import clips, rotations
from workers.physics.athlete import COORDINATES, HIGH, LOW, REVOLUTE, SPHERICAL
from workers.physics.clips import BadClip
from workers.physics.kinematics import joint_rotations, skeleton
from workers.poses import encoding, training
from workers.poses.bvh import read_bvh
from workers.poses.model import PoseModel
from workers.tasks.high_jump import HighJump, takeoff
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.settings import HighJumpSettings

FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}


@pytest.fixture(scope="module")
def poses():
    return training.gather([path for path in clips.packaged() if "walk" in path.name or "run" in path.name])


@pytest.fixture(scope="module")
def packaged_poses():
    return training.gather(clips.packaged())


@pytest.fixture(scope="module")
def model(poses):
    return training.train(np.tile(poses, (8, 1)), epochs=60)


@pytest.fixture(scope="module")
def file(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "model.safetensors"
    training.write(model, path)
    return path


def same_pose(a, b):
    hinges = skeleton().hinges
    return rotations.angle_between(joint_rotations(a, hinges), joint_rotations(b, hinges)).max() < 1e-6


def test_a_pose_survives_its_encoding():
    pose = np.random.default_rng(0).uniform(LOW, HIGH, (200, COORDINATES))
    assert encoding.encode(pose).shape == (200, encoding.SIZE)
    assert same_pose(encoding.decode(encoding.encode(pose)), pose)


def test_whatever_is_decoded_is_a_pose():
    found = encoding.decode(np.random.default_rng(1).normal(size=(50, encoding.SIZE)))
    assert found.shape == (50, COORDINATES)
    assert np.isfinite(found).all()


def test_a_half_turn_survives_its_encoding():
    pose = np.zeros((3, COORDINATES))
    for axis in range(3):
        pose[axis, axis] = np.pi
    assert same_pose(encoding.decode(encoding.encode(pose)), pose)


def test_matrices_become_quaternions():
    found = encoding.quaternions_of(Rotation.random(100, random_state=0).as_matrix())
    assert rotations.angle_between(found, Rotation.random(100, random_state=0).as_quat()).max() < 1e-9


def test_the_latent_dimension_is_counted_by_variance():
    rng = np.random.default_rng(0)
    shape = np.zeros((5000, 6))
    shape[:, :3] = rng.normal(size=(5000, 3)) * np.sqrt([6.0, 3.0, 1.0])  # shares 0.6, 0.9, 1
    assert encoding.latent_dimension(shape, 0.55) == 1
    assert encoding.latent_dimension(shape, 0.85) == 2
    assert encoding.latent_dimension(shape, 0.95) == 3


def test_the_packaged_poses_have_the_published_thirteen_dimensions(packaged_poses):
    assert encoding.latent_dimension(encoding.encode(packaged_poses)) == 13


def test_a_model_gives_back_what_it_learnt_far_better_than_the_mean_pose(model, poses):
    mean = np.tile(encoding.decode(encoding.encode(poses).mean(0)[None]), (len(poses), 1))
    body, n = skeleton(), len(poses)
    at = [body.forward(p, np.zeros((n, 3)), np.tile(rotations.IDENTITY, (n, 1))).position for p in (poses, mean)]
    baseline = np.linalg.norm(at[0] - at[1], axis=-1)[:, 1:].mean()
    assert training.fit(model, poses).position < baseline / 3


def test_latent_noise_gives_poses_within_human_ranges(model):
    found = model.decode(np.random.default_rng(0).normal(size=(100, model.latent)))
    assert np.mean((found > HIGH + 0.35) | (found < LOW - 0.35)) < 0.01


def test_equal_poses_and_seeds_give_equal_models(poses):
    many = np.tile(poses, (3, 1))
    a, b, c = (training.train(many, epochs=2, seed=seed) for seed in (0, 0, 1))
    assert a.to_bytes() == b.to_bytes()
    assert a.sha256() != c.sha256()


def test_a_model_survives_its_file(model, file):
    again = PoseModel.read(file)
    assert again.to_bytes() == model.to_bytes()
    latent = np.random.default_rng(0).normal(size=(3, model.latent))
    assert (again.decode(latent) == model.decode(latent)).all()


def test_a_model_of_another_skeleton_is_refused_with_what_is_missing(file):
    data = file.read_bytes()
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
    about = json.loads(header["halma.poses"])
    about["skeleton"] = [name for name in about["skeleton"] if "elbow" not in name]
    other = save(load(data), {"halma.poses": json.dumps(about)})
    with pytest.raises(BadJob, match="found one of another, missing right_elbow, left_elbow"):
        PoseModel.from_bytes(other)


@pytest.mark.parametrize("data", [b"", b"nonsense", save({"mean": np.zeros(3)})])
def test_what_is_no_model_is_refused(data):
    with pytest.raises(BadJob, match="expected a pose model written by `halma poses train`"):
        PoseModel.from_bytes(data)


def test_too_few_poses_are_refused(poses):
    with pytest.raises(BadJob, match="expected at least 100 poses to learn from, found 10"):
        training.train(poses[:10])


def test_the_default_model_is_trained_once_and_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("HALMA_HOME", str(tmp_path))
    monkeypatch.setattr(training.train, "__kwdefaults__", {**training.train.__kwdefaults__, "epochs": 1})
    first = training.default_model()
    monkeypatch.setattr(training, "train", lambda *_: pytest.fail("trained again"))
    assert training.default_model().to_bytes() == first.to_bytes()
    assert len(list((tmp_path / "poses").iterdir())) == 1


def env_of(file, **settings):
    s = HighJumpSettings.parse({"actions": "pose", "poses": str(file), **settings})
    return HighJumpEnv(s.take_off(FLOP), poses=s.pose_model())


def test_action_0_through_a_model_is_the_push_off_pose(model, file):
    env = env_of(file)
    assert env.action_space.shape == (model.latent + COORDINATES,)
    env.reset()
    target, offset = env._aim(np.zeros(model.latent + COORDINATES))
    assert target == pytest.approx(takeoff.push_off_pose())
    # and its offset is counted in full
    assert np.abs(offset).sum() > 2
    # what pushes is needed no more in the air, where it is a natural pose
    env.world.settle()
    target, offset = env._aim(np.zeros(model.latent + COORDINATES))
    env.close()
    assert not offset.any()
    assert target == pytest.approx(model.decode(model.encode(takeoff.natural_pose()[None]))[0])


def test_an_action_is_a_decoded_pose_plus_an_offset(model, file):
    env = env_of(file)
    action = np.random.default_rng(0).normal(size=model.latent + COORDINATES)
    latent = model.encode(takeoff.natural_pose()[None])[0] + 3.0 * action[: model.latent]
    target, offset = env._aim(action)
    env.close()
    assert offset == pytest.approx(0.5 * action[model.latent :])
    assert target - offset == pytest.approx(model.decode(latent[None])[0])


def test_the_task_takes_a_model_and_refuses_what_is_none(file, tmp_path):
    HighJump().validate({"actions": "pose", "poses": str(file)}, {}, ())
    for settings, message in (
        ({"poses": str(file)}, "expected none with actions: offset"),
        ({"actions": "pose", "poses": str(tmp_path / "none")}, "found nothing to read"),
        ({"actions": "pose", "poses": __file__}, "expected a pose model written by"),
        ({"actions": "pose", "poses": 3}, "expected the path of a file, found 3"),
    ):
        with pytest.raises(BadSetting, match=message):
            HighJump().validate(settings, {}, ())


BVH_NAMES = {
    "root": "Hips", "chest": "Chest", "neck": "Neck", "right_hip": "RightHip", "right_knee": "RightKnee",
    "right_ankle": "RightAnkle", "left_hip": "LeftHip", "left_knee": "LeftKnee", "left_ankle": "LeftAnkle",
    "right_shoulder": "RightShoulder", "right_elbow": "RightElbow", "left_shoulder": "LeftShoulder",
    "left_elbow": "LeftElbow",
}  # fmt: skip
ENDS = {
    "neck": ("Head", (0, 0.175, 0)), "right_ankle": ("RightToe", (0.12, -0.04, 0)),
    "left_ankle": ("LeftToe", (0.12, -0.04, 0)), "right_elbow": ("RightWrist", (0, -0.25, 0)),
    "left_elbow": ("LeftWrist", (0, -0.25, 0)),
}  # fmt: skip


def as_bvh(clip, unit=100.0, rename=lambda name: name):
    """The athlete's clip as a BVH file in centimetres, its joints turned by Euler angles."""
    body = skeleton()
    joint_at = body.offset * 0
    for i in range(1, len(body.names)):
        parent = body.parent[i]
        joint_at[i] = body.arm[i] + (body.offset[parent] if parent > 0 else 0)
    lines, order = ["HIERARCHY"], []

    def write(i, depth):
        pad = "  " * depth
        name = body.names[i]
        order.append(name)
        lines.append(f"{pad}{'JOINT' if i else 'ROOT'} {rename(BVH_NAMES[name])}\n{pad}{{")
        lines.append(f"{pad}  OFFSET {' '.join(f'{unit * v:.6f}' for v in joint_at[i])}")
        places = "Xposition Yposition Zposition " if i == 0 else ""
        lines.append(f"{pad}  CHANNELS {6 if i == 0 else 3} {places}Zrotation Xrotation Yrotation")
        for child in range(1, len(body.names)):
            if body.parent[child] == i:
                write(child, depth + 1)
        if name in ENDS:
            end, offset = ENDS[name]
            shown = " ".join(f"{unit * v:.6f}" for v in np.array(offset) + body.offset[i] * (name == "neck"))
            lines.append(f"{pad}  JOINT {rename(end)}\n{pad}  {{\n{pad}    OFFSET {shown}\n{pad}    CHANNELS 0")
            lines.append(f"{pad}    End Site\n{pad}    {{\n{pad}      OFFSET 0 0 0\n{pad}    }}\n{pad}  }}")
        lines.append(f"{pad}}}")

    write(0, 0)
    turns = dict(zip((*SPHERICAL, *REVOLUTE), np.moveaxis(joint_rotations(clip.pose, body.hinges), 1, 0), strict=True))
    turns["root"] = clip.orientation
    columns = [unit * clip.root]
    columns += [Rotation.from_quat(turns[name]).as_euler("ZXY", degrees=True) for name in order]
    lines += ["MOTION", f"Frames: {len(clip.root)}", f"Frame Time: {clip.period:.6f}"]
    lines += [" ".join(f"{v:.6f}" for v in row) for row in np.concatenate(columns, 1)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", ["walk", "run", "kick"])
def test_a_bvh_file_of_the_athlete_comes_back_as_its_clip(tmp_path, name):
    clip = clips.load(name)
    path = tmp_path / "clip.bvh"
    path.write_text(as_bvh(clip))
    again = read_bvh(path)
    assert again.period == pytest.approx(clip.period, abs=1e-5)
    assert again.root == pytest.approx(clip.root, abs=1e-3)
    assert rotations.angle_between(again.orientation, clip.orientation).max() < 0.01
    n = len(clip.root)
    body, still = skeleton(), (np.zeros((n, 3)), np.tile(rotations.IDENTITY, (n, 1)))
    gaps = body.forward(again.pose, *still).position - body.forward(clip.pose, *still).position
    feet = [body.names.index(f"{side}_ankle") for side in ("left", "right")]
    distance = np.linalg.norm(gaps, axis=-1)
    assert np.delete(distance, feet, 1).max() < 0.005
    assert distance[:, feet].max() < 0.06  # a foot is turned about its hinge alone


def test_other_names_for_the_same_joints_are_understood(tmp_path):
    other = {"Hip": "UpLeg", "Knee": "Leg", "Ankle": "Foot", "Toe": "ToeBase", "Shoulder": "Arm", "Elbow": "ForeArm",
             "Wrist": "Hand"}  # fmt: skip

    def rename(name):
        for side in ("Left", "Right"):
            if name.startswith(side):
                return f"mixamorig:{side}{other[name.removeprefix(side)]}"
        return {"Chest": "Spine1"}.get(name, name)

    clip = clips.load("walk")
    ours, theirs = tmp_path / "a.bvh", tmp_path / "b.bvh"
    ours.write_text(as_bvh(clip))
    theirs.write_text(as_bvh(clip, rename=rename))
    assert (read_bvh(ours).pose == read_bvh(theirs).pose).all()


def test_a_skeleton_without_arms_is_refused_with_the_names_that_are_missing(tmp_path):
    path = tmp_path / "dog.bvh"
    path.write_text(as_bvh(clips.load("walk"), rename=lambda name: name.replace("Elbow", "Paw")))
    with pytest.raises(BadClip, match="found none for left_elbow, right_elbow; the file has Hips, Chest"):
        read_bvh(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "expected a BVH file"),
        (lambda text: text.replace("}", "", 1), "left open"),
        (lambda text: text.replace("Frames: ", "Frames: 9"), "expected 9"),
        (lambda text: text.replace("Frame Time", "Time"), "expected `Frames:` and `Frame Time:`"),
        (lambda text: text.rstrip().rsplit(" ", 1)[0], r"expected \d+ values, found \d+"),
        (lambda text: text.rstrip().rsplit(" ", 1)[0] + " nan", "expected finite numbers"),
        (lambda text: text.rstrip().rsplit(" ", 1)[0] + " two", "expected numbers only"),
        (lambda text: text.replace("OFFSET 0", "OFFSET zero", 1), "expected a BVH hierarchy"),
    ],
)
def test_a_bvh_file_that_is_none_says_so(tmp_path, change, message):
    path = tmp_path / "clip.bvh"
    path.write_text(change(as_bvh(clips.load("walk"))))
    with pytest.raises(BadClip, match=message):
        read_bvh(path)
