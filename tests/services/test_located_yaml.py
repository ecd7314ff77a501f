"""Study files are YAML as people mean it, with the line of everything."""

from __future__ import annotations

import contextlib

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from services.located_yaml import DEEPEST, LARGEST, BadYaml, parse


def refusal(text: str) -> BadYaml:
    with pytest.raises(BadYaml) as caught:
        parse(text)
    return caught.value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-4", 1e-4),
        ("-3E5", -3e5),
        ("1.", 1.0),
        (".5", 0.5),
        ("12", 12),
        ("-7", -7),
        ("1_000", 1000),
        ("true", True),
        ("~", None),
        ("12:30", "12:30"),
        ("2026-01-02", "2026-01-02"),
        ("010", "010"),
        ("'on'", "on"),
        ('"1"', "1"),
        ("high_jump", "high_jump"),
    ],
)
def test_plain_values_are_read_as_people_mean_them(text, value):
    read = parse(f"a: {text}").value["a"]
    assert read == value
    assert type(read) is type(value)


def test_pyyaml_itself_reads_1e_minus_4_as_text():
    assert yaml.safe_load("a: 1e-4") == {"a": "1e-4"}


def test_every_key_and_list_entry_knows_its_line():
    located = parse("a: 1\nb:\n  c:\n    - x\n    - y\n  d: [1,\n      2]\n")
    assert located.lines == {
        (): 1, ("a",): 1, ("b",): 2, ("b", "c"): 3, ("b", "c", 0): 4, ("b", "c", 1): 5, ("b", "d"): 6,
        ("b", "d", 0): 6, ("b", "d", 1): 7,
    }  # fmt: skip


@pytest.mark.parametrize("word", ["on", "off", "yes", "No", "OFF"])
def test_bare_on_off_yes_no_are_refused(word):
    error = refusal(f"x: 1\nlog: {word}")
    assert (error.line, error.path) == (2, ("log",))
    assert str(error) == (
        f"expected true, false or quoted text, found bare {word} (write true or false, or '{word}' for the word)"
    )


def test_a_key_that_stands_twice_is_refused_with_both_lines():
    error = refusal("seed: 1\nname: a\nseed: 2\n")
    assert (error.line, error.path) == (3, ("seed",))
    assert str(error) == "expected each key once, found it again (first on line 1)"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("a: &x 1\nb: *x", 2, "expected the value itself, found the alias *x"),
        ("a: 1\n<<: {b: 1}", 2, "expected a name as key, found a merge key (<<)"),
        ("a: !!python/object:os.system 1", 1, "expected a plain value, found the tag !!python/object:os.system"),
        ("a: !!python/tuple [1]", 1, "expected a plain value, found the tag !!python/tuple"),
        ("a: 1\n---\nb: 2", 2, "expected one document, found a second one after ---"),
        ("a: 1\nb: .nan", 2, "expected a finite number, found .nan"),
        ("a: 1e999", 1, "expected a finite number, found 1e999"),
        ("? [a]\n: 1", 1, "expected a name as key, found a list or a mapping"),
        ("a: 1\nb: c: d", 2, "expected YAML, found a mistake: mapping values are not allowed here"),
        ("[" * (DEEPEST + 1), 1, f"expected at most {DEEPEST} levels of nesting, found more"),
        ("x" * (LARGEST + 1024), 0, "expected at most 256 KiB of text, found 257 KiB"),
    ],
)
def test_what_a_study_file_does_not_need_is_refused(text, line, message):
    error = refusal(text)
    assert (error.line, str(error)) == (line, message)


def test_a_tab_gets_a_hint():
    error = refusal("a:\n\tb: 1")
    assert error.line == 2
    assert str(error).endswith("(indent with spaces, not tabs)")


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc_", min_size=1), inner, max_size=3),
    max_leaves=8,
)


@given(plain)
def test_what_pyyaml_writes_is_read_back(value):
    assert parse(yaml.safe_dump({"a": value})).value == {"a": value}


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_as_bad_yaml(text):
    with contextlib.suppress(BadYaml):
        assert isinstance(parse(text).value, dict | list | str | int | float | bool | None)
