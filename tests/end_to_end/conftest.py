import pytest
from processes import Home


@pytest.fixture
def home(tmp_path):
    return Home(tmp_path)
