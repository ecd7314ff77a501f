"""Which observations a surrogate is conditioned on where the history is too long for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from search.space import Array


def farthest_first(X: Array, size: int, first: int = 0) -> NDArray[np.int64]:
    """Indices of `size` points of ``n x e``, each the farthest from those before it; ascending.

    Equal distances are decided by the lower index. Time and memory grow with n, not with its square.
    """
    if len(X) <= size:
        return np.arange(len(X))
    chosen = np.empty(size, dtype=np.int64)
    chosen[0] = first
    nearest = np.square(X - X[first]).sum(1)
    for i in range(1, size):
        chosen[i] = int(np.argmax(nearest))
        np.minimum(nearest, np.square(X - X[chosen[i]]).sum(1), out=nearest)
    return np.sort(chosen)
