"""Calibration methods, their result, its file, and its use: corrected readings and C headers."""
