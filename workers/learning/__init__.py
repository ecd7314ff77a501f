"""How does a policy learn? Problems, curricula, PPO; nothing of physics."""
