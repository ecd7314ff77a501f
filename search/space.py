"""Search spaces: parameters in natural units, and the two coordinate systems the strategies work in.

*Unit* coordinates, ``n x d`` in [0, 1]: one coordinate a parameter, in the order of the space. Discrete parameters
sit at the middle of equal cells, angles run from -pi at 0 to pi at 1 (the same point).

*Model* coordinates, ``n x e``: what a kernel may measure Euclidean distances in. Floats and integers keep their unit
coordinate, an angle becomes a point on a circle of diameter 1, a category a corner of a simplex with edge 1.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from search.errors import BadParams, BadSpace

Scalar = float | int | str | bool
Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""How far outside its bounds, relative to their distance, a value may lie from rounding alone."""


def _number(value: object, what: str, error: type[BadSpace | BadParams]) -> float:
    """The value as a finite float."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise error(f"{what}: expected a number, found {value!r}")
    if not math.isfinite(value):
        raise error(f"{what}: expected a finite number, found {value!r}")
    return float(value)


@dataclass(frozen=True, slots=True)
class Float:
    """A real parameter in [low, high].

    Args:
        low, high: inclusive bounds, natural units, low < high.
        log: search on a logarithmic scale; both bounds must be positive.
    """

    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        low, high = (_number(v, f"Float {side}", BadSpace) for v, side in ((self.low, "low"), (self.high, "high")))
        if low >= high:
            raise BadSpace(f"Float: expected low < high, found low={self.low!r}, high={self.high!r}")
        if self.log and low <= 0:
            raise BadSpace(f"Float: a logarithmic scale needs low > 0, found low={self.low!r}")

    @property
    def cells(self) -> int | None:
        """Number of distinct values; None where they are a continuum."""
        return None

    def to_unit(self, value: object) -> float:
        """Natural units -> [0, 1]. Raises `BadParams` outside the bounds."""
        v = _number(value, "a float parameter", BadParams)
        slack = TOLERANCE * (self.high - self.low)
        if not self.low - slack <= v <= self.high + slack:
            raise BadParams(f"expected a value in [{self.low!r}, {self.high!r}], found {v!r}")
        v = min(max(v, self.low), self.high)
        if self.log:
            return math.log(v / self.low) / math.log(self.high / self.low)
        return (v - self.low) / (self.high - self.low)

    def from_unit(self, u: float) -> float:
        """[0, 1] -> natural units."""
        v = self.low * (self.high / self.low) ** u if self.log else self.low + u * (self.high - self.low)
        return float(min(max(v, self.low), self.high))


@dataclass(frozen=True, slots=True)
class Int:
    """A whole-numbered parameter in low .. high, both included.

    Args:
        low, high: inclusive bounds, low <= high.
        log: search on a logarithmic scale; low must be at least 1.
    """

    low: int
    high: int
    log: bool = False

    def __post_init__(self) -> None:
        for side, v in (("low", self.low), ("high", self.high)):
            if isinstance(v, bool) or not isinstance(v, (int, np.integer)):
                raise BadSpace(f"Int {side}: expected a whole number, found {v!r}")
        if self.low > self.high:
            raise BadSpace(f"Int: expected low <= high, found low={self.low!r}, high={self.high!r}")
        if self.log and self.low < 1:
            raise BadSpace(f"Int: a logarithmic scale needs low >= 1, found low={self.low!r}")

    @property
    def cells(self) -> int | None:
        """Number of distinct values."""
        return self.high - self.low + 1

    def to_unit(self, value: object) -> float:
        """Natural units -> the middle of the value's cell. Raises `BadParams` outside the bounds."""
        v = _number(value, "an int parameter", BadParams)
        if v != round(v) or not self.low <= v <= self.high:
            raise BadParams(f"expected a whole number in {self.low} .. {self.high}, found {value!r}")
        if self.log:
            low, high = self.low - 0.5, self.high + 0.5
            # the middle of the cell, in logarithms
            return math.log(math.sqrt((v - 0.5) * (v + 0.5)) / low) / math.log(high / low)
        return (v - self.low + 0.5) / (self.high - self.low + 1)

    def from_unit(self, u: float) -> int:
        """[0, 1] -> the value whose cell holds u."""
        if self.log:
            low, high = self.low - 0.5, self.high + 0.5
            v = math.floor(low * (high / low) ** u + 0.5)
        else:
            v = self.low + math.floor(u * (self.high - self.low + 1))
        return int(min(max(v, self.low), self.high))


@dataclass(frozen=True, slots=True)
class Categorical:
    """One of several choices without order.

    Args:
        choices: distinct strings, numbers or booleans; at least one.
    """

    choices: tuple[Scalar, ...]

    def __post_init__(self) -> None:
        choices: object = self.choices
        if isinstance(choices, str) or not isinstance(choices, Sequence):
            raise BadSpace(f"Categorical: expected a list of choices, found {choices!r}")
        object.__setattr__(self, "choices", tuple(choices))
        if not self.choices:
            raise BadSpace("Categorical: expected at least one choice, found none")
        if any(not isinstance(c, (str, int, float, bool)) for c in self.choices):
            raise BadSpace(f"Categorical: expected strings, numbers or booleans, found {self.choices!r}")
        if len({(type(c), c) for c in self.choices}) < len(self.choices):
            raise BadSpace(f"Categorical: expected distinct choices, found {self.choices!r}")

    @property
    def cells(self) -> int | None:
        """Number of choices."""
        return len(self.choices)

    def to_unit(self, value: object) -> float:
        """A choice -> the middle of its cell. Raises `BadParams` for anything else."""
        for i, choice in enumerate(self.choices):
            if choice == value and isinstance(choice, bool) == isinstance(value, bool):
                return (i + 0.5) / len(self.choices)
        raise BadParams(f"expected one of {list(self.choices)!r}, found {value!r}")

    def from_unit(self, u: float) -> Scalar:
        """[0, 1] -> the choice whose cell holds u."""
        return self.choices[min(max(math.floor(u * len(self.choices)), 0), len(self.choices) - 1)]


@dataclass(frozen=True, slots=True)
class Angle:
    """A full circle, in radians. Values a full turn apart are the same; candidates lie in [-pi, pi)."""

    @property
    def cells(self) -> int | None:
        """A continuum."""
        return None

    def to_unit(self, value: object) -> float:
        """Radians -> [0, 1), whatever the number of turns."""
        return (_number(value, "an angle", BadParams) / (2 * math.pi) + 0.5) % 1.0 % 1.0

    def from_unit(self, u: float) -> float:
        """[0, 1] -> [-pi, pi); 0 and 1 are the same angle."""
        return (u % 1.0 - 0.5) * 2 * math.pi


Parameter = Float | Int | Categorical | Angle


def _parameter(name: str, spec: Any) -> Parameter:
    """A parameter from plain data: a mapping, or an object with the attributes of one."""
    if isinstance(spec, Parameter):
        return spec
    if isinstance(spec, Mapping):
        known = dict(spec)
    else:
        known = {key: getattr(spec, key, None) for key in ("kind", "low", "high", "log", "choices")}
    kind = known.get("kind")
    if kind == "angle":
        return Angle()
    try:
        if kind == "categorical":
            return Categorical(tuple(known.get("choices") or ()))
        low: Any = known.get("low")  # the constructors refuse what is no number
        high: Any = known.get("high")
        log = bool(known.get("log"))
        if kind == "float":
            return Float(low, high, log)
        if kind == "int":
            whole: list[Any] = [int(v) if isinstance(v, float) and v.is_integer() else v for v in (low, high)]
            return Int(whole[0], whole[1], log)
    except BadSpace as error:
        raise BadSpace(f"parameter {name!r}: {error}") from None
    raise BadSpace(f"parameter {name!r}: expected kind float, int, categorical or angle, found {kind!r}")


class Space:
    """An ordered set of named parameters.

    Args:
        parameters: by name. At least one must be free, i.e. have more than one value.

    Raises:
        BadSpace: no free dimension, a name that is no string, something that is no parameter.
    """

    def __init__(self, parameters: Mapping[str, Parameter]) -> None:
        for name, parameter in parameters.items():
            if not isinstance(name, str) or not name:
                raise BadSpace(f"expected parameter names that are non-empty strings, found {name!r}")
            if not isinstance(parameter, Parameter):
                raise BadSpace(f"parameter {name!r}: expected Float, Int, Categorical or Angle, found {parameter!r}")
        self.parameters: dict[str, Parameter] = dict(parameters)
        self.names: tuple[str, ...] = tuple(parameters)
        self._list = tuple(parameters.values())
        self.free: tuple[int, ...] = tuple(i for i, p in enumerate(self._list) if p.cells != 1)
        if not self.free:
            raise BadSpace(f"expected at least one parameter with more than one value, found {self!r}")
        owner: list[int] = []
        for i, p in enumerate(self._list):
            owner += [i] * self._width(p)
        self.owner: tuple[int, ...] = tuple(owner)
        """For each model coordinate, the parameter it belongs to."""

    @classmethod
    def from_specs(cls, specs: Mapping[str, Any]) -> Space:
        """A space from plain data: for each name a mapping with `kind`, `low`, `high`, `log`, `choices`.

        `kind` is `float`, `int`, `categorical` or `angle`. Objects with these attributes and ready-made parameters
        are taken as well.
        """
        return cls({name: _parameter(name, spec) for name, spec in specs.items()})

    @property
    def d(self) -> int:
        """Number of parameters."""
        return len(self.names)

    @property
    def e(self) -> int:
        """Number of model coordinates."""
        return len(self.owner)

    def __len__(self) -> int:
        return self.d

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Space) and self.names == other.names and self._list == other._list

    def __hash__(self) -> int:
        return hash((self.names, self._list))

    def __repr__(self) -> str:
        return f"Space({self.parameters!r})"

    @staticmethod
    def _width(parameter: Parameter) -> int:
        if isinstance(parameter, Angle):
            return 2
        if isinstance(parameter, Categorical):
            return len(parameter.choices)
        return 1

    def is_periodic(self) -> NDArray[np.bool_]:
        """Which parameters are angles, ``d``."""
        return np.array([isinstance(p, Angle) for p in self._list])

    def is_categorical(self) -> NDArray[np.bool_]:
        """Which parameters are categories, ``d``."""
        return np.array([isinstance(p, Categorical) for p in self._list])

    def to_unit(self, params: Mapping[str, object]) -> Array:
        """One candidate's parameters -> ``d`` unit coordinates.

        Raises:
            BadParams: a missing or unknown name, a value of the wrong kind or out of range.
        """
        if len(params) != self.d or any(name not in params for name in self.names):
            unknown = [name for name in params if name not in self.parameters]
            if unknown:
                near = difflib.get_close_matches(str(unknown[0]), self.names, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise BadParams(f"expected parameters {list(self.names)}, found unknown {unknown[0]!r}{hint}")
            missing = [name for name in self.names if name not in params]
            raise BadParams(f"expected parameters {list(self.names)}, {missing[0]!r} is missing")
        unit = np.empty(self.d)
        for i, (name, parameter) in enumerate(self.parameters.items()):
            try:
                unit[i] = parameter.to_unit(params[name])
            except BadParams as error:
                raise BadParams(f"parameter {name!r}: {error}") from None
        return unit

    def from_unit(self, unit: Array) -> dict[str, Scalar]:
        """``d`` unit coordinates -> parameters in natural units."""
        return {
            name: parameter.from_unit(float(u))
            for (name, parameter), u in zip(self.parameters.items(), unit, strict=True)
        }

    def snap(self, U: Array) -> Array:
        """Move ``n x d`` unit coordinates to where the candidates made from them would lie."""
        U = np.clip(U, 0.0, 1.0)
        out = U.copy()
        for i, p in enumerate(self._list):
            if isinstance(p, Angle):
                out[:, i] = U[:, i] % 1.0
            elif isinstance(p, Int) and p.log:
                out[:, i] = [p.to_unit(p.from_unit(float(u))) for u in U[:, i]]
            elif p.cells is not None:
                out[:, i] = (np.minimum(np.floor(U[:, i] * p.cells), p.cells - 1) + 0.5) / p.cells
        return out

    def encode(self, U: Array) -> Array:
        """``n x d`` unit coordinates -> ``n x e`` model coordinates."""
        out = np.empty((len(U), self.e))
        at = 0
        for i, p in enumerate(self._list):
            if isinstance(p, Angle):
                out[:, at] = 0.5 * np.cos(2 * np.pi * U[:, i])
                out[:, at + 1] = 0.5 * np.sin(2 * np.pi * U[:, i])
            elif isinstance(p, Categorical):
                k = len(p.choices)
                index = np.minimum(np.floor(U[:, i] * k).astype(int), k - 1)
                out[:, at : at + k] = np.eye(k)[index] * math.sqrt(0.5)
            else:
                out[:, at] = U[:, i]
            at += self._width(p)
        return out

    def encode_gradient(self, u: Array, gradient: Array) -> Array:
        """Pull a gradient in model coordinates at the point ``u`` back to unit coordinates, ``d``.

        Discrete parameters get the gradient zero for categories, and that of the relaxed problem for integers.
        """
        out = np.zeros(self.d)
        at = 0
        for i, p in enumerate(self._list):
            if isinstance(p, Angle):
                phase = 2 * np.pi * u[i]
                out[i] = np.pi * (-np.sin(phase) * gradient[at] + np.cos(phase) * gradient[at + 1])
            elif not isinstance(p, Categorical):
                out[i] = gradient[at]
            at += self._width(p)
        return out
