"""Which physics was left out of a model: locate the mismatch between a recording and its scenario,
name it, model it.
"""
