"""What several of the workers' tests start from."""

import numpy as np
import pytest

from workers.physics.world import World
from workers.replay import Recorder
from workers.tasks.high_jump.env import HighJumpEnv
from workers.tasks.high_jump.settings import HighJumpSettings

FLOP = {"alpha": 0.4, "omega_x": -3.0, "omega_z": 1.0, "v_z": -2.4}


@pytest.fixture
def world():
    world = World()
    yield world
    world.close()


@pytest.fixture(scope="session")
def jump():
    """A believable jump over 0.5 m: in the flight formulation the push-off pose alone, action 0, clears it."""
    recorder = Recorder("right_ankle", {"name": "high_jump"})
    env = HighJumpEnv(HighJumpSettings(formulation="flight").take_off(FLOP), recorder=recorder)
    env.reset(options={"level": 0.5})
    done = False
    while not done:
        _, _, done, _, info = env.step(np.zeros(28))
    env.close()
    assert info["success"]
    return recorder.replay()
