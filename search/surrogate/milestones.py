"""When hyperparameters are fitted again: a function of the number of observations, as proposals must be."""


def milestone(n: int) -> int:
    """How many observations hyperparameters are fitted to when there are n: all up to 24, then anew every 15 %."""
    if n <= 24:
        return n
    m = 24
    while True:
        step = m + max(1, (m * 3) // 20)
        if step > n:
            return m
        m = step
