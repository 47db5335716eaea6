"""Checks of the source code itself, run by ``make check``."""
