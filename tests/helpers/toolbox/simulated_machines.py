"""Simulated machines and their studies, for tests of other toolboxes: the one place that knows where they live."""

from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.effect.effects import FORMS
from loopshape.toolbox.arm.emulated import plant_file
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, Sensors, constants
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import experiment, header, measure, plan
from loopshape.toolbox.rig.study import ExperimentTemplate
from loopshape.toolbox.servo.axis import ServoAxis

__all__ = [
    "ARM1_PARAMETERS",
    "ARM2_PARAMETERS",
    "FORMS",
    "P_IN",
    "Arm1",
    "Arm2",
    "ExperimentTemplate",
    "Sensors",
    "ServoAxis",
    "constants",
    "constants2",
    "experiment",
    "header",
    "import_file",
    "measure",
    "plan",
    "plant_file",
    "read_study",
]
