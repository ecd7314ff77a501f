"""Strategies for Hypothesis: spaces, parameters, behaviours; and a toy study to drive a strategy with."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from search import Angle, Candidate, Categorical, Float, Int, Observation, Space

finite = st.floats(-1e6, 1e6, allow_nan=False)


@st.composite
def parameters(draw):
    kind = draw(st.sampled_from(["float", "log", "int", "logint", "categorical", "angle"]))
    if kind == "float":
        low = draw(st.floats(-1e3, 1e3))
        return Float(low, low + draw(st.floats(1e-3, 1e3)))
    if kind == "log":
        low = draw(st.floats(1e-6, 1e3))
        return Float(low, low * draw(st.floats(1.5, 1e6)), log=True)
    if kind == "int":
        low = draw(st.integers(-50, 50))
        return Int(low, low + draw(st.integers(1, 40)))
    if kind == "logint":
        low = draw(st.integers(1, 50))
        return Int(low, low + draw(st.integers(1, 400)), log=True)
    if kind == "categorical":
        return Categorical(tuple("abcdefg"[: draw(st.integers(2, 7))]))
    return Angle()


spaces = st.lists(parameters(), min_size=1, max_size=5).map(lambda ps: Space({f"p{i}": p for i, p in enumerate(ps)}))


@st.composite
def spaces_with_points(draw, count=1):
    space = draw(spaces)
    units = [draw(st.lists(st.floats(0, 1), min_size=space.d, max_size=space.d)) for _ in range(count)]
    return space, np.array(units)


def jump_space() -> Space:
    return Space({"alpha": Angle(), "omega_x": Float(-3, 3), "rate": Float(1e-5, 1e-2, log=True)})


def facing(params) -> list[float]:
    """A behaviour on the circle: smooth in two parameters, deaf to the third."""
    return [math.remainder(params["omega_x"] + math.sin(params["alpha"]), 2 * math.pi)]


def history_of(space: Space, count: int, seed: int, behave=facing) -> list[Observation]:
    rng = np.random.default_rng(seed)
    history = []
    for u in rng.random((count, space.d)):
        params = space.from_unit(u)
        if rng.random() < 0.2:
            history.append(Observation(Candidate(params), status="infeasible", cost=1.0))
        else:
            history.append(Observation(Candidate(params), value=float(rng.random()), features=behave(params), cost=1.0))
    return history
