"""Reference clips: what comes back, what is refused, and how often."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pybullet_data

from services.api.reference import BURST
from services.throttle import Throttle
from workers.replay import Replay

MOTION = Path(pybullet_data.getDataPath()) / "data" / "motions" / "humanoid3d_jump.txt"


def clip(seconds):
    """The first moments of a packaged clip."""
    frames = json.loads(MOTION.read_text())["Frames"]
    count = int(np.searchsorted(np.cumsum([frame[0] for frame in frames]), seconds)) + 2
    return json.dumps({"Frames": frames[:count]})


def test_a_clip_comes_back_as_a_replay(client):
    answer = client.post("/api/v1/reference", json={"text": clip(0.2), "bar": 0.8})
    assert answer.status_code == 200
    assert Replay.from_bytes(answer.content).header["bar"] == 0.8


def test_too_many_in_a_row_are_put_off_and_told_until_when(client, app):
    now = [100.0]
    app.state.clips_throttle = Throttle(burst=BURST, refill_seconds=5.0, clock=lambda: now[0])
    for _ in range(BURST):
        assert client.post("/api/v1/reference", json={"text": "no clip"}).status_code == 422
    late = client.post("/api/v1/reference", json={"text": "no clip"})
    assert late.status_code == 429
    assert late.headers["retry-after"] == "5"
    assert late.json()["error"]["message"] == f"expected at most {BURST} clips in a row, found more; try again in 5 s"
    now[0] += 5.0
    assert client.post("/api/v1/reference", json={"text": "no clip"}).status_code == 422
