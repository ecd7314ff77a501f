"""The table of what came of the faults."""

from __future__ import annotations

from book import table


def result(kind, faults):
    counts = dict.fromkeys(("lost", "duplicated", "stuck", "repeated", "most", "beside"), 0)
    return {"kind": kind, "database": "SQLite", "faults": faults, "broken": [], **counts}


def test_a_kind_that_never_happened_is_named():
    text = table([result("worker killed", 2), result("gcs killed", 0)], ["worker killed", "gcs killed", "clock jumps"])
    assert text.splitlines()[2].startswith("| worker killed | SQLite | 2 | 0 | 0 | 0 |")
    assert text.endswith("Never happened: gcs killed, clock jumps.")
