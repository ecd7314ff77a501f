"""Strategies by name. Modules are imported when asked for: a listing must not cost the seconds a torch import takes."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping
from typing import Any

from search.errors import UnknownStrategy
from search.features import Features
from search.space import Space
from search.strategy import Strategy, StrategyInfo

WHERE: dict[str, str] = {
    "random": "search.designs:Random",
    "sobol": "search.designs:Sobol",
    "edge": "search.designs:Edge",
    "bds": "search.bds.strategy:BayesianDiversitySearch",
    "cmfbo": "search.quality.cmfbo:CMFBO",
    "novelty": "search.novelty:Novelty",
    "gp_ucb": "search.quality.gp_ucb:GPUCB",
    "boca": "search.quality.gp_ucb:BOCA",
    "top_k": "search.baselines.top_k:TopK",
    "tpe": "search.baselines.optuna:TPE",
    "tpe_hyperband": "search.baselines.optuna:TPEHyperband",
    "gp": "search.baselines.optuna:OptunaGP",
    "cmaes": "search.baselines.cma:CMAES",
    "map_elites": "search.baselines.pyribs:MapElites",
    "cma_me": "search.baselines.pyribs:CMAME",
}
"""Module and class of each strategy, in the order of listings."""


def strategy_class(name: str) -> type[Strategy]:
    """The class behind a strategy's name.

    Raises:
        UnknownStrategy: with the nearest known name.
    """
    if name not in WHERE:
        near = difflib.get_close_matches(str(name), WHERE, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise UnknownStrategy(f"expected a strategy among {', '.join(WHERE)}, found {name!r}{hint}")
    module, attribute = WHERE[name].split(":")
    found: type[Strategy] = getattr(importlib.import_module(module), attribute)
    return found


def make_strategy(
    name: str, space: Space, *, features: Features | None = None, settings: Mapping[str, Any] | None = None
) -> Strategy:
    """A strategy by name.

    Args:
        name: one of `strategies()`.
        space: what to search over.
        features: what a behaviour is; None where it plays no part.
        settings: plain data; what is not given has its default.

    Raises:
        UnknownStrategy: with the nearest known name.
        BadSetting: an unknown setting, a wrong type, a value out of range, features missing where they are needed.
    """
    return strategy_class(name)(space, features, settings)


def strategies() -> list[StrategyInfo]:
    """All strategies, for listings."""
    return [strategy_class(name).info() for name in WHERE]
