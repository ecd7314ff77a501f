"""How does the athlete move? Rotations, the humanoid, its world, and pictures of it; nothing of tasks or learning."""
