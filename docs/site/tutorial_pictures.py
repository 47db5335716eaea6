"""Pictures of the tutorials, each drawn from a run of the product."""

from collections.abc import Callable
from typing import Any

PICTURES: dict[str, Callable[[], Any]] = {}
