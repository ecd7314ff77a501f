"""What people use today, behind the same contract: Optuna's samplers, CMA-ES, pyribs, and short rounds for all."""
