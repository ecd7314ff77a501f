"""Walking of a biped whose measures are searched over."""
