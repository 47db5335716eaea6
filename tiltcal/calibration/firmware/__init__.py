"""Calibrations as C99 headers for firmware, in floating point and in integers."""
