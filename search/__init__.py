"""What shall we try next? Spaces, surrogates and strategies; nothing of Ray, databases, files or physics."""
