"""Excitations and setpoints of studies, for tests of toolboxes: the one place that knows where they live."""

from loopshape.toolbox.rig.excitation.excitation import BandNoise, Prbs, Sweep
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.excitation.setpoints import Profile, Sampled, Staircase

__all__ = ["BandNoise", "Multisine", "Prbs", "Profile", "Sampled", "Staircase", "Sweep"]
