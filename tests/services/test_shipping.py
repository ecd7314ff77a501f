"""People's own modules: what belongs to a task, and that it arrives unaltered."""

import sys

import pytest

from services.errors import BadInput
from services.shipping import Bundle, collect, unpack


@pytest.fixture(autouse=True)
def folder_for_code(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


@pytest.fixture
def project(tmp_path):
    project = tmp_path / "project"
    (project / "robots" / "__pycache__").mkdir(parents=True)
    (project / "robots" / "__init__.py").write_text("from .arm import Arm\nimport shapes\n")
    (project / "robots" / "arm.py").write_text("class Arm: pass\n")
    (project / "robots" / "arm.urdf").write_text("<robot/>")
    (project / "robots" / "__pycache__" / "arm.pyc").write_bytes(b"x")
    (project / "shapes.py").write_text("import math\nimport robots\n")
    (project / "notes.py").write_text("raise SystemExit\n")
    (project / "throw.py").write_text("def throw(params, z):\n    return 1.0\n")
    return project


def names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_a_package_travels_with_its_data_and_with_what_it_imports_from_the_folder(project):
    folder = unpack(collect(project, "robots.arm:Arm"))
    assert names(folder) == ["robots/__init__.py", "robots/arm.py", "robots/arm.urdf", "shapes.py"]
    assert (folder / "robots" / "arm.urdf").read_text() == "<robot/>"


def test_a_module_travels_alone(project):
    assert names(unpack(collect(project, "throw:throw"))) == ["throw.py"]


@pytest.mark.parametrize("task", ["point_jump", "gymnasium:Pendulum-v1", "json:loads"])
def test_what_is_installed_does_not_travel(project, task):
    assert collect(project, task) is None


def test_equal_code_is_the_same_bundle_and_changed_code_another(project):
    first = collect(project, "throw:throw")
    assert collect(project, "throw:throw") == first
    (project / "throw.py").write_text("def throw(params, z):\n    return 2.0\n")
    assert collect(project, "throw:throw").sha256 != first.sha256


def test_code_with_a_wrong_syntax_travels_for_its_importer_to_say(project):
    (project / "throw.py").write_text("def throw(:\n")
    assert names(unpack(collect(project, "throw:throw"))) == ["throw.py"]


def test_code_that_is_no_code_is_refused(project, monkeypatch):
    monkeypatch.setattr("services.shipping.LARGEST_BYTES", 10)
    with pytest.raises(BadInput, match=r"expected code of at most 0 MiB to send to workers, found .* in 1 files"):
        collect(project, "throw:throw")


def test_an_altered_bundle_is_refused(project):
    bundle = collect(project, "throw:throw")
    with pytest.raises(ValueError, match=f"expected SHA-256 {bundle.sha256}, found"):
        unpack(Bundle(bundle.sha256, bundle.data + b"x"))


def test_unpacking_twice_is_once(project):
    bundle = collect(project, "throw:throw")
    assert unpack(bundle) == unpack(bundle)
    assert str(unpack(bundle)) not in sys.path
