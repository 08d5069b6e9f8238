"""What a diagnosis speaks of: plants, machines, effects, reports."""
