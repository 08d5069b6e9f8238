"""Commands of the gap."""
