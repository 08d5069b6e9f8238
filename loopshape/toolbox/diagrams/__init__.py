"""Block diagrams around one tuned block: a diagram and measured plants come in, equivalent plants go out.

Common diagrams, their files, their picture, their C code.
"""
