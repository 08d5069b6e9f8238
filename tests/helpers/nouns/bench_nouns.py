"""Nouns of the bench without a public name, for tests that build them: the one place that knows where they live."""

from loopshape.data.control.block import Block, BlockTemplate, Free
from loopshape.data.control.controller import Precision
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS
from loopshape.data.response.model import Estimate, TransferFunction
from loopshape.data.result.detuning import Detuning, Lost, MovedResonance, Reach
from loopshape.data.result.step import INDICATORS, Indicators, Step
from loopshape.data.result.verdict import RequirementResult
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.identify.settings import Settings
from loopshape.identify.structures import Integrator, Rational, ThirdOrder
from loopshape.loop.loop import Loop

__all__ = [
    "INDICATORS",
    "LIMITS",
    "LIMIT_OF",
    "Block",
    "BlockTemplate",
    "Channel",
    "Detuning",
    "Estimate",
    "Experiment",
    "Free",
    "Indicators",
    "Integrator",
    "Loop",
    "LoopSetup",
    "Lost",
    "MovedResonance",
    "Precision",
    "Rational",
    "Reach",
    "Recording",
    "RecordingInfo",
    "RequirementResult",
    "Settings",
    "Step",
    "ThirdOrder",
    "TransferFunction",
]
