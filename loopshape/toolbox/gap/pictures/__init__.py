"""Pictures of a gap."""
