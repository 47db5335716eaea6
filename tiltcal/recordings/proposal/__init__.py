"""A proposed mapping of a foreign file, with the reason of each line and what cannot be known."""
