import json

import pytest

from services.dispatch.port import (
    Assignment,
    Beat,
    Began,
    Crashed,
    Ended,
    Reported,
    Stopped,
    Vanished,
    decode,
    decode_assignment,
    encode,
    encode_assignment,
)
from services.store.port import NewArtifact

ARTIFACT = NewArtifact(name="policy.safetensors", path="0001-a/000000/1/policy.safetensors", sha256="ab" * 32, size=3)


@pytest.mark.parametrize(
    "message",
    [
        Began(1, 2, host="a", pid=3),
        Beat(1, 2),
        Reported(1, 2, iteration=4, metrics={"return_mean": 0.1 + 0.2}, samples=5, seconds=1 / 3),
        Ended(1, 2, outcome='{"status": "complete"}', artifacts=(ARTIFACT,)),
        Stopped(1, 2),
        Crashed(1, 2, message="no", retry=False),
        Vanished(1, 2, reason="gone"),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_message_survives_the_wire_to_the_last_bit(message):
    assert decode(encode(message)) == message


def test_an_assignment_survives_the_wire():
    assignment = Assignment(1, 2, "0001-a", 3, "{}", pool="big", cpus=2.0, parent_artifacts=(ARTIFACT,))
    assert decode_assignment(encode_assignment(assignment)) == assignment


def test_a_message_with_a_field_of_another_version_is_refused_by_name():
    text = json.dumps({**json.loads(encode(Beat(1, 2))), "mood": "good"})
    with pytest.raises(ValueError, match=r"Beat has no field \['mood'\]"):
        decode(text)
