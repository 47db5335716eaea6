"""Faults of the data: found, reported, and repaired before any physics is fitted."""
