from types import SimpleNamespace

from dashboards.pages import shown_details, shown_tables

CHECKS = {"foot_push": {"found": 4.7, "bound": 6.0}, "torque": {"found": 1.0, "bound": 1.0}}


def test_results_of_one_shape_become_a_table_and_leave_the_list():
    trial = SimpleNamespace(details={"bar": 0.9, "audit": {"passed": True, "checks": CHECKS}})
    assert shown_tables(trial) == [
        ("audit.checks", ["found", "bound"], [("foot push", [4.7, 6.0]), ("torque", [1.0, 1.0])])
    ]
    assert shown_details(trial) == [("bar", 0.9), ("audit.passed", True)]


def test_results_of_different_shapes_stay_in_the_list():
    trial = SimpleNamespace(details={"a": {"x": 1}, "b": {"y": 2}})
    assert shown_tables(trial) == []
    assert shown_details(trial) == [("a.x", 1), ("b.y", 2)]


def test_columns_keep_their_order_whatever_the_order_of_later_rows():
    trial = SimpleNamespace(details={"t": {"a": {"x": 1, "y": 2}, "b": {"y": 4, "x": 3}}})
    assert shown_tables(trial) == [("t", ["x", "y"], [("a", [1, 2]), ("b", [3, 4])])]
