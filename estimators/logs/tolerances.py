"""How exactly the numbers of a log's description are known, where it does not say.

Standard deviations. Masses come from a scale, inertias and heights from rules or a drawing, springs and
dampers from a catalogue; soil from a few tests at one place. These are judgements of this project.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["TOLERANCES"]

#: Number, or numbers that err together -> standard deviation, a share of the value unless stated otherwise.
TOLERANCES: Mapping[str, float] = MappingProxyType(
    {
        "m": 0.02,
        "I_z": 0.05,
        "I_y": 0.05,
        "h_cg": 0.03,
        "cg": 0.01,  #: place of the centre of gravity along the wheelbase, a share of the wheelbase
        "springs": 0.1,  #: each axle's
        "dampers": 0.15,  #: each axle's
        "r": 0.005,
        "I_w": 0.1,
        "k": 0.1,  #: k_c and k_phi together
        "c": 0.15,
        "tan_phi": 0.05,
        "K": 0.15,  #: k_x and k_y together
        "angles": 0.03,  #: a_0 and b_0, added to them
    }
)
