"""The sample rate that the lines before the data state."""

import re
from collections.abc import Mapping

_KEYS = re.compile(r"rate|freq|sampling|采样", re.IGNORECASE)
_NUMBER = re.compile(r"(\d+(?:[.,]\d+)?)\s*(k?hz|sps)?\b", re.IGNORECASE)


def stated_rate(metadata: Mapping[str, str]) -> float | None:
    """Samples a second; None where no line states them.

    Args:
        metadata: ``key: value`` lines of the file.
    """
    for key, value in metadata.items():
        found = _NUMBER.match(value.strip())
        in_hertz = found is not None and (found[2] or "hz" in key.lower())
        if _KEYS.search(key) and found is not None and in_hertz:
            thousand = (found[2] or "").lower() == "khz"
            rate = float(found[1].replace(",", ".")) * (1000 if thousand else 1)
            if rate > 0:
                return rate
    return None
