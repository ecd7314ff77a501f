"""Search for the best settings at the least cost: Gaussian processes over parameters and difficulty, and baselines."""
