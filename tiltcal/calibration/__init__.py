"""Calibration methods, their result, its file, and its use: corrected readings and C headers."""

from tiltcal.calibration.result import Calibration, Estimate

__all__ = ["Calibration", "Estimate"]
