"""A study in a coordinator's hands, for the tests of the coordinator."""

import pytest
from driven import World


@pytest.fixture(params=[()])
def world(request, tmp_path):
    made = World(tmp_path / "halma.db", overrides=request.param)
    made.coordinator.take("s")
    yield made
    made.store.close()
