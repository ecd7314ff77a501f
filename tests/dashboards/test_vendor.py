"""Bringing the browser libraries: once, whole, or with a message."""

from __future__ import annotations

import json

import pytest

from dashboards import vendor
from dashboards.vendor import FILES, STAMP, VendoringFailed, fetch, missing, relative_import


def unpack(folder):
    """What npm does, without npm."""
    for packaged in FILES:
        file = folder / "node_modules" / packaged
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("import { Plane } from 'three';\n" if file.name == "OrbitControls.js" else packaged)


def test_only_what_a_page_loads_is_kept_and_the_second_time_nothing_is_done(tmp_path):
    target = tmp_path / "vendor"
    assert fetch(target, unpack) is True
    assert sorted(path.name for path in target.iterdir()) == sorted([*FILES.values(), STAMP])
    assert missing(target) == []
    assert fetch(target, lambda _: pytest.fail("npm must not run again")) is False


def test_another_lock_file_brings_everything_again(tmp_path):
    target = tmp_path / "vendor"
    fetch(target, unpack)
    (target / STAMP).write_text("of another lock file")
    assert missing(target) == sorted(FILES.values())
    assert fetch(target, unpack) is True


def test_a_file_that_was_deleted_is_noticed(tmp_path):
    target = tmp_path / "vendor"
    fetch(target, unpack)
    (target / "plotly.js").unlink()
    assert missing(target) == ["plotly.js"]


def test_what_fails_leaves_the_old_files_and_nothing_half_done(tmp_path):
    target = tmp_path / "vendor"
    fetch(target, unpack)
    (target / STAMP).write_text("of another lock file")

    def half(folder):
        unpack(folder)
        (folder / "node_modules/three/LICENSE").unlink()

    with pytest.raises(VendoringFailed, match="expected the npm packages to hold three/LICENSE, found no such file"):
        fetch(target, half)
    assert (target / "plotly.js").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["vendor"]


def test_the_command_says_what_works_without_the_libraries(tmp_path, monkeypatch, capsys):
    def refuse():
        raise VendoringFailed("npm ci ended with 1:\nno network")

    monkeypatch.setattr(vendor, "fetch", refuse)
    assert vendor.main([]) == 1
    said = capsys.readouterr().err
    assert "no network" in said
    assert "Try again with: python -m dashboards.vendor" in said


def test_an_import_map_is_not_needed():
    assert relative_import("a\n} from 'three';\nb") == "a\n} from './three.module.js';\nb"
    with pytest.raises(VendoringFailed, match="found 0 times"):
        relative_import("import { Plane } from 'elsewhere';")


def test_the_lock_file_pins_by_integrity_and_names_no_host():
    text = (vendor.HERE / "package-lock.json").read_text()
    assert "://" not in text
    packages = {name: entry for name, entry in json.loads(text)["packages"].items() if name}
    assert packages
    assert all(entry["integrity"].startswith("sha512-") for entry in packages.values())
