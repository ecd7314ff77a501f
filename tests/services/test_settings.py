"""Where things are."""

from __future__ import annotations

import pytest

from services.errors import BadInput
from services.settings import find_settings


def test_the_default_home_holds_database_and_artifacts(tmp_path):
    settings = find_settings(environ={"HALMA_HOME": str(tmp_path)})
    assert settings.database == str(tmp_path / "halma.db")
    assert settings.artifacts == str(tmp_path / "halma.artifacts")
    assert settings.reports == tmp_path / "halma.reports"
    assert settings.token_file == tmp_path / "token"


def test_the_option_goes_before_the_environment(tmp_path):
    environ = {"HALMA_HOME": str(tmp_path), "HALMA_DB": str(tmp_path / "b.db")}
    assert find_settings(environ=environ).database == str(tmp_path / "b.db")
    assert find_settings(str(tmp_path / "c.db"), environ).artifacts == str(tmp_path / "c.artifacts")
    assert find_settings(f"sqlite:///{tmp_path}/d.db", environ).artifacts == str(tmp_path / "d.artifacts")


def test_each_database_has_artifacts_of_its_own(tmp_path):
    environ = {"HALMA_HOME": str(tmp_path)}
    urls = ["postgresql://u:secret@host/a", "postgresql://u:secret@host/b", "postgresql://other/a"]
    roots = {find_settings(url, environ).artifacts for url in urls}
    assert len(roots) == 3
    assert not any("secret" in root for root in roots)
    assert find_settings("postgresql://v:new@host/a", environ).artifacts in roots, "a new password changes nothing"


def test_artifacts_may_be_anywhere(tmp_path):
    environ = {"HALMA_HOME": str(tmp_path), "HALMA_ARTIFACTS": "s3://bucket/halma"}
    settings = find_settings(environ=environ)
    assert settings.artifacts == "s3://bucket/halma"
    assert settings.reports == tmp_path / "reports"


def test_a_home_that_is_a_file_and_an_empty_database_are_refused(tmp_path):
    (tmp_path / "home").write_text("", encoding="utf-8")
    with pytest.raises(BadInput, match="expected a folder, found the file"):
        find_settings(environ={"HALMA_HOME": str(tmp_path / "home")})
    with pytest.raises(BadInput, match="--db: expected a path or a URL, found nothing"):
        find_settings(" ", environ={"HALMA_HOME": str(tmp_path)})
