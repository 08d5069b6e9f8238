"""Loop to stability: encirclements with the contour closed, and all that may hide from the lines."""
