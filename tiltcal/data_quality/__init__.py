"""Faults that the columns of a log show by themselves, before any model: one list of checks for
every command.
"""
