"""Checks of the source itself, part of `make check`."""
