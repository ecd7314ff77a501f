"""Settings of strategies: frozen dataclasses whose fields say what they mean and what they may be."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from search.errors import BadSetting

T = TypeVar("T")


@dataclasses.dataclass(frozen=True, slots=True)
class SettingInfo:
    """A setting as listings show it.

    Args:
        name: as study files write it.
        kind: `int`, `float`, `bool`, `str` or the choices, with `| None` where it may be absent.
        default: its value where a study says nothing.
        summary: one line.
    """

    name: str
    kind: str
    default: Any
    summary: str


def setting(default: Any, summary: str, *, low: float | None = None, high: float | None = None) -> Any:
    """A field of a settings class: default, one-line meaning, inclusive bounds."""
    return dataclasses.field(default=default, metadata={"summary": summary, "low": low, "high": high})


def _options(annotation: Any) -> tuple[Any, ...]:
    """The alternatives of a union, or the annotation alone."""
    return get_args(annotation) if get_origin(annotation) in {Union, types.UnionType} else (annotation,)


def _kind(annotation: Any) -> str:
    parts = []
    for option in _options(annotation):
        if option is type(None):
            parts.append("None")
        elif get_origin(option) is Literal:
            parts.append(" | ".join(map(str, get_args(option))))
        else:
            parts.append(option.__name__)
    return " | ".join(parts)


def describe(cls: type) -> tuple[SettingInfo, ...]:
    """The settings of a settings class, in order."""
    hints = get_type_hints(cls)
    return tuple(
        SettingInfo(f.name, _kind(hints[f.name]), f.default, f.metadata["summary"]) for f in dataclasses.fields(cls)
    )


def _convert(value: Any, option: Any) -> Any:
    """The value as one of the alternatives, or NotImplemented where it is none."""
    found: Any = NotImplemented
    if option is type(None):
        found = None if value is None else found
    elif get_origin(option) is Literal:
        found = value if isinstance(value, str) and value in get_args(option) else found
    elif isinstance(value, bool):
        found = value if option is bool else found
    elif isinstance(value, str):
        found = value if option is str else found
    elif isinstance(value, (int, float)) and math.isfinite(value):
        if option is float:
            found = float(value)
        elif option is int and value == int(value):
            found = int(value)
    return found


def parse(cls: type[T], given: Mapping[str, Any], strategy: str) -> T:
    """Settings from plain data.

    Raises:
        BadSetting: an unknown name (with the nearest known one), a wrong type, a value out of bounds.
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]  # settings classes are dataclasses
    hints = get_type_hints(cls)
    values = {}
    for name, value in given.items():
        if name not in fields:
            near = difflib.get_close_matches(str(name), fields, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            known = ", ".join(fields) or "none"
            raise BadSetting(strategy, str(name), f"expected one of the known settings ({known}){hint}")
        for option in _options(hints[name]):
            converted = _convert(value, option)
            if converted is not NotImplemented:
                break
        else:
            raise BadSetting(strategy, name, f"expected {_kind(hints[name])}, found {value!r}")
        low, high = fields[name].metadata["low"], fields[name].metadata["high"]
        if isinstance(converted, (int, float)) and not isinstance(converted, bool):
            if low is not None and converted < low:
                raise BadSetting(strategy, name, f"expected at least {low}, found {converted!r}")
            if high is not None and converted > high:
                raise BadSetting(strategy, name, f"expected at most {high}, found {converted!r}")
        values[name] = converted
    return cls(**values)
