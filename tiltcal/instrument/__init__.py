"""The model of an instrument: effects of the catalogue with values and one covariance, from which
readings are predicted, corrected and compared.
"""
