"""Loop to Margins; with Requirements to Verdict."""
