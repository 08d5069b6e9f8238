"""Files of other programs: logs, FRFs and controllers in and out, and drafts of maps.

Somebody's file comes in, columns or nouns go out.
"""
