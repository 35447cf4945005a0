"""Trials of a wheel rig predicted by several structures side by side, nothing fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from estimators.rig.comparison import RigComparison, compare, predict
from estimators.rig.trials import RigTrials
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics.records import Soil, Wheel
from offroad_env.world.structures import read_structure

__all__ = ["RIG_LADDER", "compare_structures", "ladder_title", "structure_names"]

_GROUSERS = "full,slip_sinkage=lyasko,grouser_height=0.005"
#: From the paper's wheel to "field" with grousers of 5 mm, one law at a time. Ruts and the contact hull's
#: width are left out: a single wheel runs on virgin soil, and a modulus without k_c knows no width.
RIG_LADDER: Mapping[str, str] = MappingProxyType(
    {
        "paper": "paper: two strengths",
        "full": "full: one strength",
        "full,slip_sinkage=linear": "+ slip sinkage, linear",
        "full,slip_sinkage=lyasko": "+ the same, Lyasko",
        _GROUSERS: "+ grousers, 5 mm",
        f"{_GROUSERS},pressure_from=own_sinkage": "+ own sinkage",
        "field,pressure_direction=rim_normal,grouser_height=0.005": "+ shear as soil path",
        "field,grouser_height=0.005": "+ along ground normal",
    }
)


def ladder_title(structure: str) -> str:
    """What a structure is, for tables and figures."""
    return RIG_LADDER.get(structure, structure)


def structure_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names of structures, each once, with the group ``ladder`` written out.

    Raises
    ------
    InvalidParameter
        For an empty choice, or a structure that there is not.
    """
    every = [one for name in names for one in (RIG_LADDER if name == "ladder" else (name,))]
    if not every:
        raise InvalidParameter("name at least one structure")
    for name in every:
        read_structure(name)
    return tuple(dict.fromkeys(every))


def compare_structures(
    trials: RigTrials,
    soil: Soil,
    wheel: Wheel,
    structures: Sequence[str],
    *,
    resamples: int = 2000,
    seed: int = 0,
) -> dict[str, RigComparison]:
    """`compare` for each structure, over the trials that all of them can predict.

    Parameters
    ----------
    trials, soil, wheel, resamples, seed
        As in `compare`.
    structures
        Names as `read_structure` takes them.

    Raises
    ------
    DataError
        When there is no trial that all structures can predict.
    """
    inside = np.ones(len(trials), dtype=bool)
    for name in structures:
        outside = predict(trials, soil, wheel, structure=name).outside
        inside &= np.array([reason == "" for reason in outside])
    if not inside.any():
        raise DataError("no trial is inside the domain of all structures")
    shared = trials.subset(inside)
    return {
        name: compare(shared, soil, wheel, structure=name, resamples=resamples, seed=seed)
        for name in structures
    }
