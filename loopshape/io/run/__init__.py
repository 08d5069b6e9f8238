"""A run on disk: its folder, tables, journal, and what is gathered from it for a report."""
