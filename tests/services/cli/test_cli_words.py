"""Numbers, times and events as people read them."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from services.cli.events import event_line, metric_words
from services.cli.words import count, duration, first_line, number, several, value_of
from services.store.port import EventRow


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.04, "0.0 s"), (9.94, "9.9 s"), (45.4, "45 s"), (59.7, "1 min 0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")],
)
def test_durations(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [(0.0, "0"), (0.12345, "0.1235"), (1234.56, "1235"), (123456.7, "123457"), (1e-5, "1e-05"), (2.5e9, "2.5e+09"),
     (7, "7"), (-0.5, "-0.5")],
)  # fmt: skip
def test_numbers_have_four_digits_and_no_exponent_where_it_can_be_avoided(value, words):
    assert number(value) == words


def test_counts_and_plurals():
    assert count(1234567) == "1,234,567"
    assert several(1, "trial") == "1 trial"
    assert several(2, "distinct strategy") == "2 distinct strategies"


def test_values_in_cells():
    assert [value_of(v) for v in (None, True, 3, 0.5, "small", [1, 2.5])] == ["-", "yes", "3", "0.5", "small", "1, 2.5"]


def test_a_message_becomes_one_line():
    assert first_line("\n a\nb") == "a"
    assert first_line("x" * 100, 10) == "xxxxxxx..."
    assert first_line("") == ""


@pytest.mark.parametrize(
    ("kind", "payload", "words"),
    [
        ("proposed", {"strategy": "bds", "trials": [3, 4]}, "bds proposes trial 3, 4"),
        ("proposed", {"strategy": "bds", "trials": []}, "nothing more to propose"),
        (
            "progress",
            {"iteration": 3, "samples": 2100, "metrics": {"level": 0.5, "success_rate": 0.25, "kl": 1.0}},
            "iteration 3, 2,100 samples, level 0.5, success 0.25",
        ),
        ("finished", {"state": "complete", "value": 0.6, "samples": 10, "seconds": 2.0, "message": ""},
         "complete, value 0.6 (10 samples, 2.0 s)"),
        ("finished", {"state": "diverged", "value": None, "samples": 10, "seconds": 2.0, "message": "NaN at 3"},
         "diverged (10 samples, 2.0 s): NaN at 3"),
        ("lost", {"attempt": 1, "reason": "killed"}, "attempt 1 lost: killed"),
        ("preempted", {"attempt": 2, "reason": "pause"}, "attempt 2 stopped at a checkpoint: pause"),
        ("released", {"state": "paused", "reason": "interrupted"}, "paused: interrupted"),
        ("brand_new", {}, "brand_new"),
    ],
)  # fmt: skip
def test_events_in_words(kind, payload, words):
    event = EventRow(1, 1, "hill", 5, kind, payload, datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))
    assert event_line(event).partition("  ")[2] == f"trial 5: {words}"


def test_events_that_only_matter_to_programs_have_no_line():
    assert event_line(EventRow(1, 1, "hill", 5, "began", {}, datetime(2026, 1, 2, tzinfo=UTC))) is None


def test_metrics_of_an_unknown_learner_are_shown_by_name():
    assert metric_words({"b_loss": 2.0, "a": 1.0}) == "a 1, b loss 2"
