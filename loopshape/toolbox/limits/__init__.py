"""What is achievable: FRFs and requirements come in, the bandwidth that no controller exceeds goes out.

A controller of a given order near that bound goes out too.
"""
