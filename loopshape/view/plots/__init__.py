"""Pictures of responses and loops."""
