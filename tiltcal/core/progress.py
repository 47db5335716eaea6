"""Telling what a long run is doing, in words."""

from collections.abc import Callable

Progress = Callable[[str], None]


def silent(words: str) -> None:
    """Tell nobody."""
