"""The signals that a study asks for: excitations and setpoints, from numbers and a seed to samples."""
