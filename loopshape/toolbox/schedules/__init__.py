"""One robust controller against one for each operating point, and schedules out to a target.

FRFs over operating points come in, a comparison and files go out.
"""
