"""What may explain a misfit: effects of the catalogue at their shapes, curves, spectral lines."""
