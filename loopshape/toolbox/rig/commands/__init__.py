"""Commands that drive a rig."""
