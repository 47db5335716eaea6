"""Checks in front of every method: what is wrong with the readings before a model is fitted, and
which cause explains best what a model leaves.
"""
