"""Extensions of the model: what may be wrong with it, one file each, found by the finder and used by all.

An effect that is off is not composed at all. `apply` puts effects on a `Setup`; `Extension` is the file
that carries them from a diagnosis to the environment.
"""

from __future__ import annotations

from offroad_env.effects.extension import Extension, read_extension
from offroad_env.effects.library import EFFECTS, apply, find_effect
from offroad_env.effects.protocol import Effect, Inputs, Parameter, SensorErrors, Setup
from offroad_env.effects.rig_setup import RigErrors, RigSetup

__all__ = [
    "EFFECTS",
    "Effect",
    "Extension",
    "Inputs",
    "Parameter",
    "RigErrors",
    "RigSetup",
    "SensorErrors",
    "Setup",
    "apply",
    "find_effect",
    "read_extension",
]
