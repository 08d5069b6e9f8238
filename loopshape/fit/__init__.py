"""FRF to Fit."""
