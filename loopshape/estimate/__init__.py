"""Run to FRF."""
