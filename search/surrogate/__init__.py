"""Gaussian processes: kernels, posteriors, and how their hyperparameters are fitted."""
