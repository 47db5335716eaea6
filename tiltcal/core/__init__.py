"""Constants and units, sign conventions, array types, the users' error, files, progress,
quantisation.
"""
