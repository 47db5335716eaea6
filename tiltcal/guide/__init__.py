"""Guidance while a recording is made: what the sensor reads, which pose comes next, and when the
uncertainties are small enough.
"""
