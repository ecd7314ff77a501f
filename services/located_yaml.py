"""YAML as plain values that remember their line.

A reader of our own above PyYAML's parser, because a study file is written by hand and read by people:

- every value knows where it was written, so that an error can name the line;
- `1e-4` is a number (PyYAML follows YAML 1.1, where it is text);
- bare `on off yes no` are refused (YAML 1.1 reads them as true and false, YAML 1.2 as text), and so are duplicate keys,
  aliases (a small file can expand into a huge one), tags and several documents;
- dates, octal, hexadecimal and sexagesimal numbers (`12:30`) are text; nothing in a study needs them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

Path = tuple[str | int, ...]
"""Where a value stands: keys of mappings and indices of lists, from the outermost in."""

LARGEST = 256 * 1024
"""Characters that a file may have."""

DEEPEST = 24
"""Levels that a file may be nested; far below what would exhaust the parser's recursion."""

_INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)$")
_FLOAT = re.compile(r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?$")
_NOT_FINITE = re.compile(r"[-+]?\.(?:inf|nan)$", re.IGNORECASE)
_TRUTH = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_NOTHING = {"", "~", "null", "Null", "NULL"}
_AMBIGUOUS = {"on", "off", "yes", "no"}


class BadYaml(ValueError):
    """The text is no YAML that we accept.

    Args:
        line: from 1; 0 where no line is to blame.
        path: where in the document, as far as it is known.
        message: what was expected and what was found.
    """

    def __init__(self, line: int, path: Path, message: str) -> None:
        super().__init__(message)
        self.line = line
        self.path = path
        self.message = message


@dataclass(frozen=True, slots=True)
class Located:
    """A document and the lines of its parts.

    Args:
        value: None, bool, int, float, str, and lists and string-keyed dicts of them.
        lines: line (from 1) of each value and each key, by path.
    """

    value: Any
    lines: dict[Path, int] = field(default_factory=dict)


def parse(text: str) -> Located:
    """Read one YAML document.

    Raises:
        BadYaml: with the line, for everything that is not accepted.
    """
    if len(text) > LARGEST:
        raise BadYaml(0, (), f"expected at most {LARGEST // 1024} KiB of text, found {len(text) // 1024} KiB")
    _refuse_unwanted(text)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise _broken(error) from None
    lines: dict[Path, int] = {}
    return Located(None if node is None else _value(node, (), lines), lines)


def scalar(text: str) -> Any:
    """The value of a plain (unquoted) scalar. Raises `ValueError` with a message for people."""
    if text in _NOTHING:
        return None
    if text in _TRUTH:
        return _TRUTH[text]
    if text.lower() in _AMBIGUOUS:
        message = (
            f"expected true, false or quoted text, found bare {text} (write true or false, or '{text}' for the word)"
        )
        raise ValueError(message)
    if _INTEGER.match(text):
        return int(text.replace("_", ""))
    if _NOT_FINITE.match(text):
        raise ValueError(f"expected a finite number, found {text}")
    if _FLOAT.match(text) and not re.match(r"[-+]?0[0-9]", text):
        number = float(text.replace("_", ""))
        if not math.isfinite(number):
            raise ValueError(f"expected a finite number, found {text}")
        return number
    return text


def _refuse_unwanted(text: str) -> None:
    """One pass over the parser's events, before anything is built from them."""
    depth = documents = 0
    for event in _events(text):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.AliasEvent):
            raise BadYaml(line, (), f"expected the value itself, found the alias *{event.anchor}")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.DocumentStartEvent):
            documents += 1
        if depth > DEEPEST:
            raise BadYaml(line, (), f"expected at most {DEEPEST} levels of nesting, found more")
        if documents > 1:
            raise BadYaml(line, (), "expected one document, found a second one after ---")


def _events(text: str) -> Iterator[yaml.Event]:
    try:
        yield from yaml.parse(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise _broken(error) from None


def _broken(error: yaml.YAMLError) -> BadYaml:
    """PyYAML's words for what it stumbled over, without its drawing of the place."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it can't be parsed"
    context = getattr(error, "context", None)
    where = f" {context}" if context else ""
    hint = " (indent with spaces, not tabs)" if "\\t" in str(problem) else ""
    return BadYaml(mark.line + 1 if mark else 0, (), f"expected YAML, found a mistake{where}: {problem}{hint}")


def _value(node: yaml.Node, path: Path, lines: dict[Path, int]) -> Any:
    line = node.start_mark.line + 1
    lines.setdefault(path, line)
    if isinstance(node, yaml.ScalarNode):
        return _scalar_value(node, path, line)
    if isinstance(node, yaml.SequenceNode):
        _refuse_tag(node, "tag:yaml.org,2002:seq", path)
        return [_value(child, (*path, index), lines) for index, child in enumerate(node.value)]
    _refuse_tag(node, "tag:yaml.org,2002:map", path)
    return _mapping(node, path, lines)


def _mapping(node: yaml.Node, path: Path, lines: dict[Path, int]) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for key_node, child in node.value:
        line = key_node.start_mark.line + 1
        if not isinstance(key_node, yaml.ScalarNode):
            raise BadYaml(line, path, "expected a name as key, found a list or a mapping")
        key = key_node.value
        if key_node.style is None and key == "<<":
            raise BadYaml(line, path, "expected a name as key, found a merge key (<<)")
        here = (*path, key)
        if key in mapping:
            raise BadYaml(line, here, f"expected each key once, found it again (first on line {lines[here]})")
        lines[here] = line
        mapping[key] = _value(child, here, lines)
    return mapping


def _scalar_value(node: yaml.ScalarNode, path: Path, line: int) -> Any:
    if node.style is not None:
        _refuse_tag(node, "tag:yaml.org,2002:str", path)
        return node.value
    if _tagged(node):
        raise BadYaml(line, path, f"expected a plain value, found the tag {_short(node.tag)}")
    try:
        return scalar(node.value)
    except ValueError as error:
        raise BadYaml(line, path, str(error)) from None


def _tagged(node: yaml.ScalarNode) -> bool:
    """Whether a plain scalar carries a tag that it would not have got by itself."""
    plain = yaml.SafeLoader("").resolve(yaml.ScalarNode, node.value, (True, False))  # type: ignore[no-untyped-call]  # no stub
    return bool(node.tag != plain)


def _refuse_tag(node: yaml.Node, plain: str, path: Path) -> None:
    if node.tag != plain:
        raise BadYaml(node.start_mark.line + 1, path, f"expected a plain value, found the tag {_short(node.tag)}")


def _short(tag: str) -> str:
    return tag.replace("tag:yaml.org,2002:", "!!")
