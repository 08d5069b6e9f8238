"""Whether a recording is fit for an estimate: feedback, faults, distortion, who plays which part."""
