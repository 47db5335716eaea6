"""What a model states in a few characters and MuJoCo makes much of: refused before it compiles.

MuJoCo compiles in this process, without limits of time or memory. What a file holds itself is
bounded by its size, but for elements, of which 20000 geoms take 2 s and 100000 more than 25 s.
"""

from collections.abc import Iterator
from contextlib import suppress
from math import prod
from xml.etree.ElementTree import Element

from tiltcal.core.errors import TiltcalError

MOST_BODIES = 2000
MOST_ELEMENTS = 20000
COPIES = {"replicate": "count", "flexcomp": "count", "composite": "count"}
"""Attribute by which an element becomes so many bodies, those in it as many times."""
FIELDS = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
MOST_POINTS = 2**24
"""Of a field or a picture: 4096 x 4096 compile in 0.6 s, 20000 x 20000 not in 25 s."""
MOST_KEYS = 10000
"""Of a number in ``<size>``: as many key frames compile in 0.2 s, ten times as many not in 25 s."""


def require_few(root: Element, name: str) -> None:
    """Refuse a part of a model that MuJoCo would make too much of.

    Args:
        root: of the part.
        name: of its file.

    Raises:
        TiltcalError: naming the element, what it states and what is taken.
    """
    waiting, seen = [(root, 1)], 0
    while waiting:
        above, times = waiting.pop()
        for element in above:
            seen += 1
            copies = times * _product(element, COPIES.get(element.tag, ()))
            if copies > MOST_BODIES:
                raise _too_much(name, element.tag, "copies", MOST_BODIES)
            for tag, found, most in _stated(element):
                if found > most:
                    raise _too_much(name, element.tag, tag, most)
            waiting.append((element, copies))
    if seen > MOST_ELEMENTS:
        raise _too_much(name, root.tag, "elements", MOST_ELEMENTS)


def _stated(element: Element) -> Iterator[tuple[str, int, int]]:
    """What an element states in numbers, how many, and how many are taken."""
    if element.tag in FIELDS:
        names = FIELDS[element.tag]
        yield " x ".join(names), _product(element, names), MOST_POINTS
    if element.tag == "size":
        for name in element.attrib:
            if name.startswith("n"):  # others are bytes, which MuJoCo refuses itself
                yield name, _product(element, name), MOST_KEYS


def _product(element: Element, names: str | tuple[str, ...]) -> int:
    """Product of the numbers in some attributes, 1 of those that are not there or no numbers,
    which MuJoCo refuses itself.
    """
    found = 1
    for name in (names,) if isinstance(names, str) else names:
        with suppress(ValueError):
            found *= prod(max(int(n), 1) for n in element.get(name, "1").split())
    return found


def _too_much(name: str, tag: str, what: str, most: int) -> TiltcalError:
    return TiltcalError(
        f"model {name}, element {tag}",
        found=f"more than {most} {what}",
        need=f"at most {most}",
        do="leave out what does not carry the instrument",
    )
