"""Loop to margins: crossings, peaks, bandwidths, the rms of an error, with intervals."""
