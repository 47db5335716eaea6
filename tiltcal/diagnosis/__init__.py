"""What was left out of the model: locate the mismatch between a recording and its scenario, name
it, model it.
"""
