"""The search's errors, one tree. Every message says what was expected, what was found, and what to do."""

from __future__ import annotations


class SearchError(Exception):
    """Base of everything the search raises on purpose."""


class BadSpace(SearchError):
    """A parameter or a space is not searchable: reversed bounds, no choices, nothing free."""


class BadFeatures(SearchError):
    """A feature space is declared wrongly, or a behaviour doesn't lie in it."""


class BadParams(SearchError):
    """Parameters don't belong to the space: a name is missing or unknown, a value is out of range or not a number."""


class BadHistory(SearchError):
    """An observation or a pending candidate can't be learnt from; the message names its index."""


class BadCount(SearchError):
    """Fewer than one candidate was asked for."""


class BadSetting(SearchError):
    """A setting of a strategy is unknown, of the wrong type or out of range.

    Args:
        strategy: name of the strategy.
        field: name of the setting.
        message: what was expected and what was found.
    """

    def __init__(self, strategy: str, field: str, message: str) -> None:
        super().__init__(f"{strategy}: setting {field!r}: {message}")
        self.strategy = strategy
        self.field = field
        self.message = message


class UnknownStrategy(SearchError):
    """No strategy of that name."""


class MissingExtra(SearchError):
    """The strategy needs an optional package that isn't installed; the message names the extra."""
