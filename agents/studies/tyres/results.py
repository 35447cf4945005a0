"""What the flexible tyre gives where something is published, and the published number beside it."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.stats import spearmanr

from offroad_env.errors import SolverFailure
from offroad_env.physics.records import Soil, Tyre, Wheel
from offroad_env.physics.tyre import hard_ground_deflection, tyre_stiffness
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.tyres import TYRES, make_tyre
from offroad_env.world.vehicles import make_wheel

__all__ = [
    "STRUCTURE",
    "Comparison",
    "CurvePoint",
    "Snow",
    "field_ruts",
    "hard_ground_pressures",
    "load_deflection",
    "pressure_effects",
    "rut_ranks",
    "sand",
    "side_forces",
    "snow",
    "stiffnesses",
    "towed",
    "wheel_of",
]

#: Laws of the soil: a single wheel on virgin ground, without the grid's contact hull.
STRUCTURE = "grid,width=rim"
_GOODYEAR = "goodyear_335_65r22_5"


class CurvePoint(NamedTuple):
    """A point of a load-deflection curve."""

    inflation: float  #: [Pa]
    deflection: float  #: [m]
    load: float  #: measured [N]
    model: float  #: [N]


class Comparison(NamedTuple):
    """A published number and what the model has instead."""

    case: str
    quantity: str
    published: float
    model: float
    agrees: bool  #: in direction


def rows_of(folder: Path, name: str) -> list[dict[str, str]]:
    """Rows of one of the published files."""
    with (folder / f"{name}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def wheel_of(tyre: Tyre) -> Wheel:
    """The wheel that a tyre stands on."""
    return make_wheel(r=tyre.r, b=tyre.b)


def load_deflection(folder: Path) -> list[CurvePoint]:
    """Published loads of the Goodyear tyre, and the model's at the same deflections."""
    points = []
    for row in rows_of(folder, "goodyear_335_65r22p5_load_deflection"):
        deflection = float(row["deflection_m"])
        if deflection > 0.0:
            tyre = make_tyre(_GOODYEAR, inflation=float(row["inflation_Pa"]))
            share = deflection / (0.08 * tyre.r)
            model = tyre_stiffness(tyre) * deflection * share**tyre.stiffening
            points.append(CurvePoint(tyre.inflation, deflection, float(row["load_N"]), model))
    return points


def stiffnesses(folder: Path) -> list[Comparison]:
    """Published vertical stiffness [N/m] and the model's secant at the nominal load."""
    found = []
    for row in rows_of(folder, "goodyear_335_65r22p5_stiffness"):
        tyre = make_tyre(_GOODYEAR, inflation=float(row["inflation_Pa"]))
        load, published = float(row["nominal_load_N"]), float(row["vertical_stiffness_N_per_m"])
        secant = load / hard_ground_deflection(tyre, load)
        case = f"Goodyear, {tyre.inflation / 1e3:.0f} kPa"
        found.append(Comparison(case, "stiffness [kN/m]", published / 1e3, secant / 1e3, True))
    for row in rows_of(folder, "mavs_tyre_stiffness"):
        inflation, published = float(row["inflation_Pa"]), float(row["spring_constant_as_printed"])
        rule = make_tyre(r=float(row["undeflected_radius_m"]), b=float(row["width_m"]), inflation=inflation)
        case = f"MAVS by the rule of make_tyre, {inflation / 1e3:.0f} kPa"
        model = tyre_stiffness(rule) / 1e3
        found.append(Comparison(case, "stiffness [kN/m]", published / 1e3, model, True))
    return found


def hard_ground_pressures(folder: Path) -> list[Comparison]:
    """Mean contact pressure on hard ground over inflation pressure: about 1 at the rated load (T4)."""
    found = []
    for row in rows_of(folder, "goodyear_335_65r22p5_stiffness"):
        tyre = make_tyre(_GOODYEAR, inflation=float(row["inflation_Pa"]))
        load = float(row["nominal_load_N"])
        length = 2.0 * math.sqrt(2.0 * tyre.r * hard_ground_deflection(tyre, load))
        ratio = load / (tyre.b * length) / tyre.inflation
        case = f"Goodyear, {tyre.inflation / 1e3:.0f} kPa, rated load"
        found.append(Comparison(case, "contact / inflation pressure", 1.0, ratio, 0.8 < ratio < 1.25))
    return found


def sand(pressure: float, n: float = 0.8) -> Soil:
    """Dry sand of this pressure [Pa] at 5 cm and this exponent."""
    return make_soil("dry_sand", k_c=0.0, k_phi=pressure / 0.05**n, n=n)


def towed(soil: Soil, tyre: Tyre, load: float) -> tuple[float, float]:
    """(resistance over load [-], sinkage [m]) of a wheel that turns without torque."""
    slip = np.linspace(-0.4, 0.02, 43)
    found = wheel_forces(soil, wheel_of(tyre), load=load, slip=slip, structure=STRUCTURE, tyre=tyre)
    free = float(np.interp(0.0, found.torque, slip))
    return -float(np.interp(free, slip, found.F_x)) / load, float(found.sinkage[0])


def _pull(soil: Soil, tyre: Tyre, load: float, slip: float) -> float:
    """Pull over load [-]."""
    found = wheel_forces(soil, wheel_of(tyre), load=load, slip=slip, structure=STRUCTURE, tyre=tyre)
    return float(found.F_x) / load


def _sinkage(soil: Soil, tyre: Tyre, load: float) -> float:
    found = wheel_forces(soil, wheel_of(tyre), load=load, slip=0.0, structure=STRUCTURE, tyre=tyre)
    return float(found.sinkage)


def _soil_of_rut(rut: float, tyre: Tyre, load: float) -> Soil:
    """Sand on which the tyre sinks as deep as a published rut [m]."""

    def excess(log_pressure: float) -> float:
        try:
            return math.log(_sinkage(sand(math.exp(log_pressure)), tyre, load) / rut)
        except SolverFailure:
            return 1.0

    return sand(math.exp(brentq(excess, math.log(2e4), math.log(2e7), xtol=1e-4)))


def pressure_effects(folder: Path) -> list[Comparison]:
    """From 270 to 650 kPa by the formulas of Maclaurin and Brixius, and by the model.

    The model's soil is the sand on which the tyre at 270 kPa sinks as deep as Maclaurin's rut, so that
    only the effect of the pressure is compared.
    """
    table = rows_of(folder, "derived_pressure_sweep")
    found = []
    for load in sorted({float(row["load_N"]) for row in table}):
        for cone in sorted({float(row["cone_index_Pa"]) for row in table}):
            rows = [r for r in table if (float(r["load_N"]), float(r["cone_index_Pa"])) == (load, cone)]
            soft, hard = (
                min(rows, key=lambda r: float(r["inflation_Pa"])),
                max(rows, key=lambda r: float(r["inflation_Pa"])),
            )
            found += _pressure_effect(load, cone, soft, hard)
    return found


def _pressure_effect(
    load: float, cone: float, soft: dict[str, str], hard: dict[str, str]
) -> list[Comparison]:
    low, high = (make_tyre(_GOODYEAR, inflation=float(row["inflation_Pa"])) for row in (soft, hard))
    soil = _soil_of_rut(float(soft["maclaurin_rut_m"]), low, load)
    (mrr_low, z_low), (mrr_high, z_high) = towed(soil, low, load), towed(soil, high, load)
    pull_low, pull_high = _pull(soil, low, load, 0.2), _pull(soil, high, load, 0.2)
    case = f"{load / 1e3:.0f} kN, cone index {cone / 1e3:.0f} kPa"
    rut = float(hard["maclaurin_rut_m"]) / float(soft["maclaurin_rut_m"])
    mrr = float(hard["towed_MRR_B7"]) / float(soft["towed_MRR_B7"])
    net = float(hard["net_traction_at_slip_0p2"]) - float(soft["net_traction_at_slip_0p2"])
    model_rut, model_mrr, model_net = z_high / z_low, mrr_high / mrr_low, pull_high - pull_low
    return [
        Comparison(case, "rut, ratio (Maclaurin)", rut, model_rut, model_rut > 1.0),
        Comparison(case, "towed resistance, ratio (Brixius)", mrr, model_mrr, model_mrr > 1.0),
        Comparison(case, "net traction at slip 0.2, change (Brixius)", net, model_net, model_net < 0.0),
    ]


def _bin_soils(folder: Path) -> dict[str, Soil]:
    """The soil bin at three densities; k read as kPa/m^n, strength of sandy loam."""
    return {
        row["soil_state"]: make_soil(
            "dry_sand",
            k_c=0.0,
            k_phi=1e3 * float(row["k_as_printed"]),
            n=float(row["sinkage_exponent_n"]),
        )
        for row in rows_of(folder, "ansorge2007_soil_plate")
    }


#: Tyre of the catalogue by the size that the table prints.
_SIZES = {
    "500/70 R24": "500_70r24",
    "500/85 R24": "500_85r24",
    "600/55-26.5": "600_55_26_5",
    "710/45-26.5": "710_45_26_5",
}


def rut_ranks(folder: Path) -> tuple[list[Comparison], float]:
    """Ruts of four tyres at 4.5 t [mm] in the soil bin and the model's sinkage; rank correlation."""
    soil = _bin_soils(folder)["medium"]
    found = []
    for row in rows_of(folder, "ansorge2007_rut_single_pass"):
        tyre = make_tyre(_SIZES[row["tyre_size"]], inflation=float(row["inflation_Pa"]))
        model = _sinkage(soil, tyre, float(row["load_N"]))
        case = f"{row['tyre_size']}, {tyre.inflation / 1e3:.0f} kPa"
        found.append(Comparison(case, "rut [mm]", 1e3 * float(row["rut_depth_m"]), 1e3 * model, True))
    rank = float(spearmanr([one.published for one in found], [one.model for one in found])[0])
    return found, rank


def field_ruts(folder: Path) -> list[Comparison]:
    """Rut at 350 over rut at 250 kPa on three soils of a field, and the model's on three states of the bin.

    Size and load of that machine are those of the thesis' combine harvester (10.5 t on an 800 mm tyre,
    diameter 1.9 m): our assumption, since its page was not seen.
    """
    table = rows_of(folder, "ansorge2007_rut_field")
    states = ("soft", "medium", "dense")
    model = []
    for state in states:
        soil = _bin_soils(folder)[state]
        soft, hard = (make_tyre(r=0.95, b=0.8, inflation=p) for p in (250e3, 350e3))
        model.append(_sinkage(soil, hard, 103e3) / _sinkage(soil, soft, 103e3))
    found = []
    for soil_name, ratio, state in zip(
        dict.fromkeys(row["soil"] for row in table), model, states, strict=True
    ):
        normal, high = (
            float(next(r for r in table if r["soil"] == soil_name and word in r["treatment"])[column])
            for word, column in (("normal", "rut_depth_max_m"), ("high", "rut_depth_max_m"))
        )
        case = f"{soil_name}; model: bin soil, {state}"
        found.append(Comparison(case, "deepest rut, 350 / 250 kPa", high / normal, ratio, ratio > 1.0))
    return found


class Snow(NamedTuple):
    """Resistance against sinkage in snow."""

    sinkage: tuple[float, ...]  #: measured [m]
    resistance: tuple[float, ...]  #: measured, over load [-]
    model_sinkage: tuple[float, ...]  #: [m]
    model_resistance: tuple[float, ...]  #: [-]
    rank: float  #: rank correlation of the measurements
    slope: float  #: d ln resistance / d ln sinkage, measured
    model_slope: float


def snow(folder: Path) -> Snow:
    """CRREL's tyres of 0.38 m radius in snow, and the light truck tyre on snow of the catalogue."""
    rows = [r for r in rows_of(folder, "crrel2001_snow_sinkage_resistance") if not r["note"]]
    rows = [r for r in rows if float(r["sinkage_m"]) <= float(r["snow_depth_m"])]
    z = np.array([float(r["sinkage_m"]) for r in rows])
    resistance = np.array([float(r["resistance_coefficient"]) for r in rows])
    tyre = TYRES["crrel_light_truck"]
    base = SOILS["snow"]
    model = []
    for factor in np.geomspace(1.0, 30.0, 10):
        soil = make_soil(base, k_c=factor * base.k_c, k_phi=factor * base.k_phi)
        try:
            model.append(towed(soil, tyre, 6800.0))
        except SolverFailure:
            continue
    own, depth = np.array([one[0] for one in model]), np.array([one[1] for one in model])
    return Snow(
        tuple(z.tolist()),
        tuple(resistance.tolist()),
        tuple(depth.tolist()),
        tuple(own.tolist()),
        float(spearmanr(z, resistance)[0]),
        float(np.polyfit(np.log(z), np.log(resistance), 1)[0]),
        float(np.polyfit(np.log(depth), np.log(own), 1)[0]),
    )


def side_forces(pressures: Sequence[float], tyre: Tyre | None, load: float = 3400.0) -> np.ndarray:
    """Side force over load [-] at 10 degrees on sand of these pressures at 5 cm [Pa]."""
    wheel = make_wheel(r=0.33, b=0.212)
    return np.array(
        [
            -float(
                wheel_forces(
                    sand(p),
                    wheel,
                    load=load,
                    slip=0.0,
                    slip_angle=math.radians(10.0),
                    structure="grid",
                    tyre=tyre,
                ).F_y
            )
            / load
            for p in pressures
        ]
    )
