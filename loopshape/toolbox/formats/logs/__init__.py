"""Logs of others as signals by name, one file a format."""
