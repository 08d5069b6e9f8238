"""Where a tuning begins and how it climbs."""
