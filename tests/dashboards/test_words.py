"""Numbers and times in words."""

from __future__ import annotations

import math

import pytest

from dashboards import words
from dashboards.login import inside
from dashboards.rendering import as_json


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (12345, "12\u202f345"),
        (-0.5, "\u22120.5"),
        (1 / 3, "0.3333"),
        ("Fosbury", "Fosbury"),
    ],
)
def test_numbers(value, text):
    assert words.number(value) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "–"),
        (0.26, "0.3\u202fs"),
        (59.7, "1\u202fmin 0\u202fs"),
        (3725, "1\u202fh 2\u202fmin"),
        (172800, "2\u202fd 0\u202fh"),
    ],
)
def test_durations_have_two_units_at_most(seconds, text):
    assert words.duration(seconds) == text


def test_angles_are_told_in_degrees():
    assert words.feature(-math.pi / 2, "rad") == "\u221290°"
    assert words.feature(1.234, "m") == "1.23\u202fm"


def test_lists_and_mappings_are_told_part_by_part():
    assert words.listing([1.5654135088, -2]) == "1.565, \u22122"
    assert words.listing({"from": [0.5], "kind": "relu"}) == "from 0.5, kind relu"


@pytest.mark.parametrize("target", ["https://evil.example", "//evil.example", "/\\evil.example", "evil", "/a\nb", ""])
def test_a_login_leads_only_inside(target):
    assert inside(target) == "/"


def test_nothing_in_a_data_block_can_end_it():
    assert "<" not in as_json({"name": "</script><script>alert(1)</script>"})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("bar", 0.9, "0.9\u202fm"),
        ("facing", math.pi / 2, "90°"),
        ("reward", 0.5, "0.5"),
        ("bar", None, "–"),
        ("cleared", True, "yes"),
        ("name", "layout", "layout"),
    ],
)
def test_named_results_have_their_units(name, value, text):
    assert words.result(value, name) == text
