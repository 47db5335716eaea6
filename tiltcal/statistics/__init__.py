"""Statistics of samples: least squares, robust location, noise of means, Allan variance, noise
spectra.
"""
