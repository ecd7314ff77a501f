import sys

import pytest

from tests.workers.toy_environments import OwnTask
from workers import registry
from workers.contracts import BadJob
from workers.registry import BUILT_IN, list_tasks, load_task, task_names
from workers.tasks.function import FunctionTask
from workers.user_code import TaskImportFailed, UnknownTask


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory of the user's, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        path = getattr(sys.modules[name], "__file__", None) or ""
        if path.startswith(str(tmp_path)):
            del sys.modules[name]


def test_a_built_in_task_is_found_by_its_name():
    assert load_task("point_jump").info({}).name == "point_jump"


def test_an_unknown_name_is_refused_with_the_nearest_ones():
    with pytest.raises(UnknownTask) as refusal:
        load_task("pont_jump")
    assert str(refusal.value).startswith("task 'pont_jump': unknown; did you mean 'point_jump'")
    assert str(refusal.value).endswith("gymnasium:ID and module:attribute")
    assert isinstance(refusal.value, BadJob)


def test_every_built_in_task_is_listed():
    assert set(BUILT_IN) <= set(task_names())
    assert [info.name for info in list_tasks()] == task_names()


def test_a_task_that_cannot_be_loaded_does_not_spoil_the_list(monkeypatch):
    monkeypatch.setattr("workers.registry.BUILT_IN", {"gone": "no_such_module_at_all:Task"})
    (info,) = [info for info in list_tasks() if info.name == "gone"]
    assert info.summary.startswith("can't be loaded: ")
    assert "no module named 'no_such_module_at_all'" in info.summary


def test_a_function_in_the_working_directory_is_a_task(here):
    (here / "my_hill.py").write_text("def f(params, z):\n    '''A hill.'''\n    return 1.0\n")
    task = load_task("my_hill:f")
    assert isinstance(task, FunctionTask)
    assert task.info({}).summary == "A hill."


def test_a_class_with_the_tasks_methods_is_a_task_and_so_is_an_instance(here):
    assert isinstance(load_task("tests.workers.toy_environments:OwnTask"), OwnTask)
    (here / "my_instance.py").write_text("from tests.workers.toy_environments import OwnTask\ntask = OwnTask()\n")
    assert load_task("my_instance:task").info({}).summary == "its own"


def test_an_environment_class_is_a_task(here):
    info = load_task("tests.workers.toy_environments:Target").info({})
    assert info.summary.startswith("Three steps")
    assert info.trains


def test_a_file_of_the_users_never_hides_a_module_of_the_standard_library(here):
    (here / "statistics.py").write_text("raise RuntimeError('wrong one')\n")
    sys.modules.pop("statistics", None)
    assert load_task("statistics:mean").info({}).summary.startswith("Return the sample arithmetic mean")


def test_what_is_neither_function_environment_nor_task_is_refused(here):
    (here / "my_odd.py").write_text("number = 3\nclass Plain: pass\n")
    with pytest.raises(UnknownTask, match=r"expected a function, a gymnasium.Env class or a Task, found a int"):
        load_task("my_odd:number")
    with pytest.raises(
        UnknownTask, match=r"expected a function, a gymnasium.Env class or a Task, found the class Plain"
    ):
        load_task("my_odd:Plain")


def test_a_missing_module_is_told_with_the_folder_that_was_searched(here):
    with pytest.raises(UnknownTask) as refusal:
        load_task("nowhere.at_all:f")
    assert str(refusal.value) == (
        "task 'nowhere.at_all:f': expected an importable module, found no module named 'nowhere'; "
        f"run from the folder that holds it ({here} was searched), or install its package"
    )


def test_a_missing_attribute_is_told_with_the_nearest_one(here):
    (here / "my_names.py").write_text("def jump(params): return 0.0\n")
    with pytest.raises(UnknownTask, match=r"'my_names' has no 'jmp'; did you mean 'jump'\?"):
        load_task("my_names:jmp")


def test_a_module_that_fails_to_import_is_told_by_the_users_traceback_with_ours_left_out(here):
    (here / "my_helper.py").write_text("def check():\n    raise RuntimeError('no licence')\n")
    (here / "my_broken.py").write_text("import my_helper\n\nmy_helper.check()\n")
    with pytest.raises(TaskImportFailed) as refusal:
        load_task("my_broken:f")
    assert str(refusal.value) == (
        "task 'my_broken:f': its module could not be imported\n"
        "Traceback (most recent call last):\n"
        f'  File "{here}/my_broken.py", line 3, in <module>\n'
        "    my_helper.check()\n"
        f'  File "{here}/my_helper.py", line 2, in check\n'
        "    raise RuntimeError('no licence')\n"
        "RuntimeError: no licence"
    )


@pytest.mark.parametrize(
    ("source", "last"),
    [
        ("import numpyy\n", "ModuleNotFoundError: No module named 'numpyy'"),
        ("def f(:\n", "SyntaxError: invalid syntax"),
        ("raise SystemExit(3)\n", "SystemExit: 3"),
    ],
)
def test_whatever_an_import_raises_is_told(here, source, last):
    (here / "my_failing.py").write_text(source)
    with pytest.raises(TaskImportFailed) as refusal:
        load_task("my_failing:f")
    assert str(refusal.value).splitlines()[-1] == last
    assert "workers/" not in refusal.value.trace
    assert "importlib" not in refusal.value.trace


class TestEntryPoints:
    @pytest.fixture
    def package(self, here, monkeypatch):
        """An installed package that offers two tasks."""
        about = here / "jumps-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: jumps\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text("[halma.tasks]\nmy_jump = my_jumps:f\nmy_fall = my_falls:f\n")
        (here / "my_jumps.py").write_text("def f(params):\n    '''A jump.'''\n    return 1.0\n")
        (here / "my_falls.py").write_text("1 / 0\n")
        monkeypatch.syspath_prepend(str(here))
        return here

    def test_a_packages_task_is_found_by_its_name(self, package):
        assert load_task("my_jump").info({}).summary == "A jump."
        assert "my_jump" in task_names()

    def test_packages_are_looked_through_once_not_for_each_trial(self, package, monkeypatch):
        load_task("my_jump")
        monkeypatch.setattr(registry, "entry_points", lambda **_: pytest.fail("looked through again"))
        assert load_task("my_jump").info({}).summary == "A jump."

    def test_what_is_installed_while_a_service_runs_is_found(self, package):
        load_task("my_jump")
        about = package / "later-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: later\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text("[halma.tasks]\nmy_later_jump = my_jumps:f\n")
        assert load_task("my_later_jump").info({}).summary == "A jump."

    def test_one_that_fails_to_import_is_told_and_listed_as_such(self, package):
        with pytest.raises(TaskImportFailed, match="ZeroDivisionError: division by zero"):
            load_task("my_fall")
        summaries = {info.name: info.summary for info in list_tasks()}
        assert summaries["my_fall"] == "can't be loaded: ZeroDivisionError: division by zero"
