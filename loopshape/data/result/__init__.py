"""What is found: verdicts and their words, baselines, detuning margins, predictions, what a report says."""
