"""What is recorded: channels, excitations, experiments, recordings, runs and the studies that ask for them."""
