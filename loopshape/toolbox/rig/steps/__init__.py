"""A measurement that is judged while it is made: amplitudes step by step, and when it is long enough."""
