"""Behaviour features that a study file declares for people's own functions and environments."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workers.contracts import JSON, BadSetting, FeatureSpec
from workers.user_code import suggestion

_KEYS = ("kind", "names", "low", "high", "distinct", "unit")
_SECTION = "task.settings"


def declared_features(settings: Mapping[str, JSON]) -> FeatureSpec | None:
    """What `settings["features"]` declares, or None.

    A study file writes

        features: {kind: euclidean, names: [height, turn], low: [0, -1], high: [2, 1], distinct: 0.3}
        features: {kind: circle, names: [facing], distinct: 0.5}

    Raises `BadSetting` naming the field, what was expected and found.
    """
    given = settings.get("features")
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise BadSetting(_SECTION, "features", f"expected a mapping with {', '.join(_KEYS)}, found {given!r}")
    for key in given:
        if key not in _KEYS:
            raise BadSetting(_SECTION, f"features.{key}", f"unknown setting{suggestion(key, _KEYS)}")
    kind = given.get("kind")
    if kind not in {"euclidean", "circle", "rotation"}:
        raise BadSetting(_SECTION, "features.kind", f"expected euclidean, circle or rotation, found {kind!r}")
    names = _names(given.get("names"), kind)
    distinct: Any = given.get("distinct")
    if not _is_number(distinct) or not distinct > 0:
        raise BadSetting(_SECTION, "features.distinct", f"expected a number above 0, found {distinct!r}")
    low, high = (_bounds(given, key, len(names), kind) for key in ("low", "high"))
    for name, a, b in zip(names, low, high, strict=True) if low else ():
        if a >= b:
            raise BadSetting(_SECTION, "features.low", f"expected less than high for {name!r}, found {a:g} and {b:g}")
    return FeatureSpec(kind, names, float(distinct), low, high, str(given.get("unit", "")))


def _names(given: JSON, kind: str) -> tuple[str, ...]:
    count = {"circle": 1, "rotation": 4}.get(kind)
    if given is None and kind == "rotation":
        return ("x", "y", "z", "w")
    if not isinstance(given, list | tuple) or not given or not all(isinstance(n, str) for n in given):
        raise BadSetting(_SECTION, "features.names", f"expected a list of names, found {given!r}")
    if count is not None and len(given) != count:
        raise BadSetting(_SECTION, "features.names", f"expected {count} for kind {kind}, found {len(given)}")
    return tuple(given)


def _bounds(given: Mapping[str, JSON], key: str, count: int, kind: str) -> tuple[float, ...]:
    value = given.get(key)
    if kind != "euclidean":
        if value is not None:
            raise BadSetting(_SECTION, f"features.{key}", f"expected none for kind {kind}, found {value!r}")
        return ()
    if not isinstance(value, list | tuple) or len(value) != count or not all(_is_number(v) for v in value):
        raise BadSetting(_SECTION, f"features.{key}", f"expected a list of {count} numbers, found {value!r}")
    return tuple(float(v) for v in value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


class WrongFeatures(Exception):
    """A behaviour doesn't fit its declaration. The message says what was expected and found."""


def read_behaviour(spec: FeatureSpec | None, behaviour: Any) -> tuple[float, ...] | None:
    """A behaviour that user code gave, in the coordinates of its declaration.

    NaN and infinite coordinates pass: the caller decides what they mean. Raises `WrongFeatures`.
    """
    if behaviour is None:
        if spec is not None:
            raise WrongFeatures(f"expected {len(spec.names)} features ({', '.join(spec.names)}), found none")
        return None
    if spec is None:
        raise WrongFeatures(
            f"expected no features, found {behaviour!r}; declare them in the study file under task.settings.features"
        )
    try:
        values = np.atleast_1d(np.asarray(behaviour, np.float64))
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (len(spec.names),):
        raise WrongFeatures(f"expected {len(spec.names)} features ({', '.join(spec.names)}), found {behaviour!r}")
    if spec.kind == "rotation" and np.isfinite(values).all() and abs(np.linalg.norm(values) - 1) > 1e-3:
        raise WrongFeatures(f"expected a unit quaternion, found {behaviour!r} of length {np.linalg.norm(values):.4g}")
    return tuple(float(v) for v in values)


def mean_behaviour(spec: FeatureSpec, behaviours: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """The mean of several behaviours in the metric of their kind.

    Circle: the direction of the mean unit vector, rad. Rotation: the mean quaternion, signs aligned with the first
    (Markley et al. 2007 average the outer products; for rotations as close as those of one policy the two agree).
    """
    rows = np.array(behaviours)
    if spec.kind == "circle":
        return (float(np.arctan2(np.sin(rows).mean(), np.cos(rows).mean())),)
    if spec.kind == "rotation":
        rows = rows * np.where(rows @ rows[0] < 0, -1.0, 1.0)[:, None]
        mean = rows.mean(0)
        return tuple(float(v) for v in mean / np.linalg.norm(mean))
    return tuple(float(v) for v in rows.mean(0))
