"""Measuring from scripts and commands: the rig is driven, a run is written, the target is stopped."""
