"""What shall we try next? Spaces, surrogates and strategies; nothing of Ray, databases, files or physics."""

from search.distinct import Cluster, cluster_joined, distinct
from search.errors import (
    BadCount,
    BadFeatures,
    BadHistory,
    BadParams,
    BadSetting,
    BadSpace,
    MissingExtra,
    SearchError,
    UnknownStrategy,
)
from search.features import Features
from search.record import Candidate, Observation
from search.registry import make_strategy, strategies
from search.settings import SettingInfo
from search.space import Angle, Categorical, Float, Int, Space
from search.strategy import Strategy, StrategyInfo

__all__ = [
    "Angle",
    "BadCount",
    "BadFeatures",
    "BadHistory",
    "BadParams",
    "BadSetting",
    "BadSpace",
    "Candidate",
    "Categorical",
    "Cluster",
    "Features",
    "Float",
    "Int",
    "MissingExtra",
    "Observation",
    "SearchError",
    "SettingInfo",
    "Space",
    "Strategy",
    "StrategyInfo",
    "UnknownStrategy",
    "cluster_joined",
    "distinct",
    "make_strategy",
    "strategies",
]
