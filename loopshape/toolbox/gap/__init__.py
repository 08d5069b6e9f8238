"""Why the simulation lies: a run and a machine that can be followed come in, a gap report goes out.

Machines of one's own (`own`, `mechanism`) live here too.
"""
