"""A run's report as one page of HTML that needs nothing beside itself: markup and SVG as text, from nouns."""
