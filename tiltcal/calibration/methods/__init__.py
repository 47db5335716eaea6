"""Calibration methods: (Recording, Setup) -> Calibration. Built in, installed as entry points, or
the user's own.
"""
