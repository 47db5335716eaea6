"""What to record next, and doing it: a block that tells rivals apart, and the loop of diagnosing
and recording.
"""
