"""Pictures of verdicts and predictions over operating points."""
