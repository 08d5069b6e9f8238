"""Kernels over the lines of a response: local sums, smoothing, spectra, draws of its error."""
