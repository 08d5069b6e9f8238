"""FRFs in files of others, one file a format."""
