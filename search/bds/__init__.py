"""Bayesian diversity search (Yin, Yang, van de Panne, Yin: Discovering Diverse Athletic Jumping Strategies, 2021)."""
