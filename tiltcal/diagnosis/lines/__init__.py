"""Spectral lines and transients of what a model leaves: more hypotheses for the search."""
