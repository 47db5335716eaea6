"""Odd values for the trees of TOML and JSON files."""

import copy
import json
import tomllib
from typing import Any

import numpy as np
import tomli_w

Path = tuple[str | int, ...]
ODD: tuple[Any, ...] = (
    float("nan"),
    float("inf"),
    -float("inf"),
    0,
    -1,
    1,
    0.0,
    -1e-300,
    1e-308,
    1e12,
    1e300,
    -1e300,
    10**6,
    10**9,
    10**18,
    10**400,
    True,
    "",
    "x",
    "nan",
    "1",
    "../x",
    "\x1b[31mred\x07",
    "=1+1",
    "<script>alert(1)</script>",
    "*/ int x; /*",
    "a\nb",
    "\u202e\u0000"[:1],
    "é" * 300,
    [],
    {},
    [[]],
    [float("nan")],
    [1e300, -1e300],
    [0.0, 0.0, 0.0],
    ["x"],
    {"a": 1},
)


def mutated_tree(tree: Any, rng: np.random.Generator, times: int) -> Any:
    """A copy with some places changed."""
    tree = copy.deepcopy(tree)
    for _ in range(times):
        places = list(paths(tree))
        if places:
            change(tree, places[rng.integers(len(places))], rng)
    return tree


def paths(tree: Any, above: Path = ()) -> Any:
    """The path of every value below the root."""
    if isinstance(tree, dict | list):
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield (*above, key)
            yield from paths(value, (*above, key))


def change(tree: Any, path: Path, rng: np.random.Generator) -> None:
    """Replace, remove, scale, repeat or rename one value in place."""
    owner = tree
    for key in path[:-1]:
        owner = owner[key]
    key = path[-1]
    value = owner[key]
    kind = rng.integers(8)
    if kind == 0:
        del owner[key]
    elif kind == 1 and is_number(value) and abs(value) < 1e300:
        owner[key] = scaled(value, rng)
    elif kind == 2 and isinstance(value, list) and value:
        owner[key] = value * int(rng.integers(2, 5)) if rng.random() < 0.5 else value[:-1]
    elif kind == 3 and isinstance(owner, dict):
        owner[f"{key}{'' if rng.random() < 0.3 else 'x'}"] = owner.pop(key)
    elif kind == 4 and isinstance(owner, dict):
        owner[f"odd_{rng.integers(9)}"] = odd(rng)
    else:
        owner[key] = odd(rng)


def is_number(value: Any) -> bool:
    """Whether it is a number and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def scaled(value: float, rng: np.random.Generator) -> float:
    """A number of another size or sign."""
    factor = float(rng.choice([-1, 0.5, 2, 1e3, 1e6, 1e9, 1e-6, 1e-12, 1e60]))
    found = value * factor
    return int(found) if isinstance(value, int) and abs(found) < 1e18 else float(found)


def odd(rng: np.random.Generator) -> Any:
    """One of the odd values."""
    return copy.deepcopy(ODD[rng.integers(len(ODD))])


def mutated_toml(content: bytes, rng: np.random.Generator) -> bytes:
    """A TOML file with odd values."""
    tree = mutated_tree(tomllib.loads(content.decode()), rng, int(rng.integers(1, 4)))
    return tomli_w.dumps(tree).encode(errors="surrogatepass")


def mutated_json(content: bytes, rng: np.random.Generator) -> bytes:
    """A JSON file with odd values, those that are no JSON too."""
    return json.dumps(mutated_tree(json.loads(content), rng, int(rng.integers(1, 4)))).encode()
