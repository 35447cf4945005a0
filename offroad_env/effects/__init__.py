"""Effects: the ways in which the model may be wrong, for diagnosis, environment and filters.

Compiled laws have a file each; shifts of a parameter, a sensor or an input are rows of the tables. An
effect that is off is not composed at all. `apply` puts effects on a `Setup`; `Extension` is the file that
brings them from a diagnosis to the environment.
"""

from __future__ import annotations

from offroad_env.effects.extension import Extension, read_extension
from offroad_env.effects.library import EFFECTS, FORMER_IDS, apply, find_effect
from offroad_env.effects.protocol import Effect, Inputs, Parameter, SensorErrors, Setup
from offroad_env.effects.rig_setup import RigErrors, RigSetup

__all__ = [
    "EFFECTS",
    "FORMER_IDS",
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
