"""Calibrations as C headers for firmware."""
