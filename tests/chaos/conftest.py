import pytest
from arena import Undisturbed
from forks import Forks


@pytest.fixture(scope="session")
def forks(tmp_path_factory):
    opened = Forks(tmp_path_factory.mktemp("forks"))
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def undisturbed(forks, tmp_path_factory):
    return Undisturbed(forks, tmp_path_factory.mktemp("undisturbed"))


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def server(request):
    """The database of the study: None for SQLite."""
    return None if request.param == "sqlite" else request.getfixturevalue("postgres_server")
