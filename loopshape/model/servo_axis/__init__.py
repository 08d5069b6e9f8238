"""One mass under a position controller: friction, perhaps a spring, and what such an axis may hide."""
