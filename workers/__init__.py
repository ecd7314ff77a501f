"""How is one trial run? Tasks, physics, learning; nothing of searches, databases or other trials."""
