"""Which experiment to make: a first short recording comes in, a plan with its excitation goes out.

`tone` tells what a recording holds by itself: rms, and tones that the excitation does not explain.
"""
