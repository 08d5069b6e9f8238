"""The machine: simulated, or a real-time target over a wire; an experiment comes in, a recording goes out.

`c_target` is the reference target in C99.
"""
