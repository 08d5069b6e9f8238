"""A user's own machine: a simulator with generic effects composed around it, followed in short windows."""
