"""Rms of each channel and tones that the excitation does not explain."""
