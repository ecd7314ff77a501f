"""How often somebody may do something that costs: a bucket for each of them that fills up again."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable


class Throttle:
    """`burst` times at once, then once more every `refill_seconds`.

    The keys are bounded, the longest unseen are forgotten first.

    Args:
        burst: how often at once.
        refill_seconds: how long until once more is allowed.
        clock: monotonic seconds; tests pass their own.
        most_addresses: how many keys are remembered.
    """

    def __init__(
        self,
        *,
        burst: int,
        refill_seconds: float,
        clock: Callable[[], float] = time.monotonic,
        most_addresses: int = 4096,
    ) -> None:
        self._burst = burst
        self._refill = refill_seconds
        self._clock = clock
        self._most = most_addresses
        self._spent: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def wait(self, key: str) -> float:
        """Seconds until this one may (0 where it may now)."""
        spent = self._level(key)
        return max(0.0, (spent - (self._burst - 1)) * self._refill) if spent > self._burst - 1 else 0.0

    def spend(self, key: str) -> None:
        """Count one more."""
        self._spent[key] = (self._level(key) + 1.0, self._clock())
        self._spent.move_to_end(key)
        while len(self._spent) > self._most:
            self._spent.popitem(last=False)

    def _level(self, key: str) -> float:
        spent, at = self._spent.get(key, (0.0, 0.0))
        return max(0.0, spent - (self._clock() - at) / self._refill)
