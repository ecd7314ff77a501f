"""Files that trials leave: where they are, what they are called, and that they are whole."""
