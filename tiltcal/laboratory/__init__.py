"""Scenario files, and who makes recordings from them: simulated laboratories, random
instruments.
"""
