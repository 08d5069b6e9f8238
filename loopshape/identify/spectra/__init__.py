"""Signals to spectra: transforms, segments, periods, their averages and coherence."""
