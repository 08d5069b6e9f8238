"""Experiment to Recording: the simulated rig."""
