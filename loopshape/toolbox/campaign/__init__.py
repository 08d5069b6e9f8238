"""One study on many simulated machines: a campaign file comes in, a folder of runs and a table go out.

Work is shared out to processes of this machine or to a Dask cluster.
"""
