"""The linear model of a recording: columns of hypotheses, the fit, its noise, its
cross-validation.
"""
