"""Signs and sizes that abstracts report (T1 to T10 of the published table), asked of the model."""

from __future__ import annotations

import numpy as np

from agents.studies.tyres.results import STRUCTURE, sand, towed, wheel_of
from offroad_env.physics.records import Soil, Tyre
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.tyres import make_tyre

__all__ = ["trend_checks"]

_SLIP = np.linspace(0.02, 0.6, 30)


def _best_pull(soil: Soil, tyre: Tyre, load: float) -> float:
    """Largest pull [N] at a slip of 0.02 to 0.6."""
    found = wheel_forces(soil, wheel_of(tyre), load=load, slip=_SLIP, structure=STRUCTURE, tyre=tyre)
    return float(np.max(found.F_x))


def _gain(soil: Soil, tyre: Tyre, load: float, low: float, high: float) -> float:
    """Gain of the largest pull from the lower of two inflation pressures [Pa]."""
    pulls = [_best_pull(soil, make_tyre(tyre, inflation=p), load) for p in (low, high)]
    return pulls[0] / pulls[1] - 1.0


def trend_checks() -> list[tuple[str, str, str, str]]:
    """(check, published, model, verdict) of every line."""
    farm = make_tyre(r=0.60, b=0.35, inflation=160e3)  # 11.2R24 to 400/55-22.5
    small = make_tyre(r=0.30, b=0.13, inflation=200e3)  # 5-12
    loam, loose, firm = sand(150e3), sand(50e3, 1.0), make_soil(SOILS["clay"], k_phi=3e6)
    t1 = _gain(loam, farm, 10e3, 100e3, 200e3)
    pulls = [_best_pull(loam, farm, load) for load in (8e3, 12e3)]
    t2 = pulls[1] / pulls[0] - 1.0
    t5 = [towed(loam, make_tyre(small, inflation=p), 2e3)[0] for p in (166e3, 193e3, 221e3)]
    t7, t8 = _gain(loose, farm, 10e3, 100e3, 200e3), _gain(firm, farm, 10e3, 100e3, 200e3)
    wide = make_tyre(r=0.60, b=0.45, inflation=160e3)
    t9 = towed(loam, wide, 10e3)[0] / towed(loam, farm, 10e3)[0] - 1.0
    low, high = (
        wheel_forces(
            loam,
            wheel_of(farm),
            load=10e3,
            slip=0.1,
            structure=STRUCTURE,
            tyre=make_tyre(farm, inflation=p),
        )
        for p in (100e3, 200e3)
    )
    t10 = float(high.sinkage) > float(low.sinkage) and float(high.deflection) < float(low.deflection)
    return [
        (
            "T1 lower pressure, net traction",
            "+16 % at most",
            f"{t1:+.1%} from 200 to 100 kPa",
            _same(t1 > 0.0),
        ),
        ("T2 higher load, net traction", "+35 % at most", f"{t2:+.0%} from 8 to 12 kN", _same(t2 > 0.0)),
        ("T3 stress 0.1 m deep over inflation", "1.39 on average", "no law of stress in depth", "not asked"),
        ("T4 contact over inflation pressure", "about 1 at rated load", "see above", "differs"),
        (
            "T5 towed resistance, 221 to 193 kPa",
            "improves",
            f"{t5[1] / t5[2] - 1.0:+.0%}",
            _same(t5[1] < t5[2]),
        ),
        (
            "T6 towed resistance, 221 to 166 kPa",
            "deteriorates",
            f"{t5[0] / t5[2] - 1.0:+.0%}",
            _same(t5[0] > t5[2]),
        ),
        (
            "T7 largest pull on loose soil",
            "at the HIGHER pressure",
            f"{t7:+.1%} at the lower",
            _same(t7 < 0.0),
        ),
        ("T8 largest pull on firm soil", "at the LOWER pressure", f"{t8:+.1%} at the lower", _same(t8 > 0.0)),
        ("T9 wider section, rolling resistance", "lower", f"{t9:+.0%} from 0.35 to 0.45 m", _same(t9 < 0.0)),
        ("T10 higher pressure", "sinks more, deflects less", "same" if t10 else "not so", _same(t10)),
    ]


def _same(agrees: bool) -> str:
    return "agrees" if agrees else "differs"
