"""Study files: which experiments to do to which rig."""
