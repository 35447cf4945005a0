"""Accuracy against cost of one force evaluation: `python benchmarks/accuracy_cost.py --out FOLDER`.

Contacts of a drive over rough ground under random commands, evaluated with rules of 8 to 40 nodes a
segment in one piece, with the eight-node rule made for the patch, and with the two rules as the
kernels choose their pieces (fast, and fine for the public function). Errors refer to an
evaluation with 64 nodes in three pieces; times are CPU times of a compiled loop. Writes
accuracy_cost.json and accuracy_cost.png.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact_angles import AngleShares, wong_reece_angles
from offroad_env.physics.contact_patch import contact_patch
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.quadrature import WHOLE, Rule
from offroad_env.physics.record_operations import record_from
from offroad_env.physics.records import ContactOptions, Wheel, WheelMotion
from offroad_env.physics.slip import ShearKinematics, shear_kinematics, slip_ratio
from offroad_env.physics.soil_constants import SoilConstants, soil_constants
from offroad_env.physics.stress_integrals import add_nodes, add_piece, integrate_stresses, patch_stress
from offroad_env.simulation.simulator import FULL_STEP, make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import add, paper_terrain, rough_terrain
from offroad_env.world.vehicles import VEHICLES

#: What the force law promises, as a share of the load.
LIMIT = 1e-6
#: Cases are rolling wheels: the rules in one piece know no cut where the shear changes its sign.
ROLLING = (0.0, 0.6)
REPEATS = 40
_SIGNS = (1.0, 1.0)


class Cases(NamedTuple):
    """Contacts, a row each: what `integrate_stresses` takes, taken apart."""

    constants: np.ndarray  #: (N, 8)
    shares: np.ndarray  #: (N, 2)
    h: np.ndarray  #: (N,) [m]
    kinematics: np.ndarray  #: (N, 3)


@kernel
def _row(cases, i):
    return (
        record_from(SoilConstants, cases.constants[i], ()),
        record_from(AngleShares, cases.shares[i], ()),
        cases.h[i],
        record_from(ShearKinematics, cases.kinematics[i], ()),
    )


@kernel
def run_kernel(cases, options, out):
    """Forces by the kernel's own choice of rule and pieces into ``out`` (N, 4)."""
    for i in range(out.shape[0]):
        constants, shares, h, kinematics = _row(cases, i)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = integrate_stresses(
            constants, shares, h, kinematics, options
        )


@kernel
def run_pieces(cases, resultant, rule, edges, out):
    """Forces by one rule on the pieces between ``edges`` (of t) into ``out`` (N, 4)."""
    for i in range(out.shape[0]):
        constants, shares, h, kinematics = _row(cases, i)
        patch, stress = contact_patch(shares, h, constants.r), patch_stress(constants, kinematics)
        area, torque = constants.area, constants.area * constants.r
        x = y = z = t = 0.0
        for j in range(edges.shape[0] - 1):
            ends = (edges[j], edges[j + 1])
            p_x, p_y, p_z, p_t = add_piece(patch, stress, resultant, _SIGNS, ends, rule)
            x, y, z, t = x + p_x, y + p_y, z + p_z, t + p_t
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = area * x, -area * y, area * z, torque * t


@kernel
def run_whole(cases, resultant, rule, out):
    """Forces by the eight nodes of ``rule`` (shares, weights) into ``out`` (N, 4)."""
    for i in range(out.shape[0]):
        constants, shares, h, kinematics = _row(cases, i)
        patch, stress = contact_patch(shares, h, constants.r), patch_stress(constants, kinematics)
        area, torque = constants.area, constants.area * constants.r
        x, y, z, t = add_nodes(patch, stress, resultant, _SIGNS, rule)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = area * x, -area * y, area * z, torque * t


def drive(soil: str, seed: int) -> tuple[Cases, np.ndarray]:
    """Contacts of 20 s of driving on ``soil``, and the load of each wheel [N]."""
    rng = np.random.default_rng(seed)
    vehicle = VEHICLES["mrzr"]
    plant = make_plant(vehicle, SOILS[soil], add(rough_terrain("D", rng), paper_terrain(0.05)))
    wheel = Wheel(vehicle.r, vehicle.b)
    state, warm = settled_state(plant, v_x=4.0)
    readings, rows, loads = np.zeros(at.READINGS_SIZE), [], []
    for i in range(1000):
        if i % 25 == 0:
            steer, push = rng.uniform(-1.0, 1.0), rng.uniform(0.1, 0.8)
        command = (steer * vehicle.steer_max, push * vehicle.drive_torque_max, 0.0)
        full_advance(state, warm, command, plant, FULL_STEP, 4, readings)
        for first in (0, at.AXLE):
            motion = WheelMotion(*(readings[first + j] for j in (at.R_OMEGA, at.V_L, at.V_C)))
            slip = slip_ratio(motion.rim_speed, motion.v_l, plant.v_eps)
            h = readings[first + at.SINKAGE]
            if not (ROLLING[0] < slip < ROLLING[1] and motion.v_l > 1.0 and h > 0.0):
                continue
            rows.append(
                (
                    soil_constants(plant.soil, wheel),
                    wong_reece_angles(plant.soil, slip),
                    h,
                    shear_kinematics(motion, plant.v_eps),
                )
            )
            loads.append(readings[first + at.N] / vehicle.wheels_per_axle)
    cases = Cases(*(np.array([row[i] for row in rows]) for i in range(4)))
    return cases, np.array(loads)


def nanoseconds(work, count: int) -> float:
    """Least CPU time of one evaluation in ``REPEATS`` runs of ``count`` [ns]."""
    work()
    best = np.inf
    for _ in range(REPEATS):
        start = time.process_time()
        for _ in range(5):
            work()
        best = min(best, time.process_time() - start)
    return 1e9 * best / (5 * count)


def measure(soil: str, resultant: float) -> list[dict[str, object]]:
    """Error and time of every rule on the contacts of one soil."""
    cases, loads = drive(soil, seed=1)
    r = cases.constants[0, 6]
    truth, found = np.empty((len(loads), 4)), np.empty((len(loads), 4))
    exact = Rule(64, 4)
    run_pieces(cases, resultant, (exact.table, exact.quartic), np.array([0.0, 0.25, 0.6, 1.0]), truth)
    whole = np.array([0.0, 1.0])
    rows = []
    for p in (3, 4):
        for nodes in (8, 16, 24, 32, 40):
            rule = Rule(nodes, p)
            tables = (rule.table, rule.quartic)
            spent = nanoseconds(lambda t=tables: run_pieces(cases, resultant, t, whole, found), len(loads))
            row = {"rule": f"u = t^{p}, {nodes} nodes", "kind": f"t^{p}", "nodes": nodes, "ns": spent}
            rows.append(row | error_of(found, truth, loads, r))
    for name, work in (
        ("made for the patch, 8 nodes", lambda: run_whole(cases, resultant, WHOLE, found)),
        (
            "fast, as the kernels use it",
            lambda: run_kernel(cases, ContactOptions(0.0, resultant, False), found),
        ),
        (
            "fine, as the public function uses it",
            lambda: run_kernel(cases, ContactOptions(0.0, resultant, True), found),
        ),
    ):
        spent = nanoseconds(work, len(loads))
        rows.append({"rule": name, "kind": name, "ns": spent} | error_of(found, truth, loads, r))
    return rows


def error_of(found: np.ndarray, truth: np.ndarray, loads: np.ndarray, r: float) -> dict[str, float]:
    """Median and largest error of the forces (torque: over the radius), as shares of the load."""
    error = (np.abs(found - truth) / [1.0, 1.0, 1.0, r]).max(axis=1) / loads
    return {"median": float(np.median(error)), "largest": float(error.max())}


def draw(results: dict[str, list[dict]], path: Path) -> None:
    """Largest error against time, a panel for each soil."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    marks = {
        "t^3": ("0.5", "o-", "Gauss-Legendre at u = t³, 8 to 40 nodes"),
        "t^4": ("#0072B2", "s-", "Gauss-Legendre at u = t⁴, 8 to 40 nodes"),
        "made for the patch, 8 nodes": ("#009E73", "D", "made for the patch, 8 nodes"),
        "fast, as the kernels use it": ("#D55E00", "*", "fast: the simulation"),
        "fine, as the public function uses it": ("#CC79A7", "P", "fine: the public function"),
    }
    figure, axes = plt.subplots(1, len(results), figsize=(9.5, 4.8), sharey=True, layout="constrained")
    for axis, (soil, rows) in zip(axes, results.items(), strict=True):
        for kind, (colour, style, label) in marks.items():
            some = [row for row in rows if row["kind"] == kind]
            axis.plot(
                [row["ns"] for row in some],
                [max(row["largest"], 1e-15) for row in some],
                style,
                color=colour,
                label=label,
                markersize=10 if kind.startswith("fast") else 6,
            )
        axis.axhline(LIMIT, color="black", linestyle="--", linewidth=1.0)
        axis.set(
            xscale="log", yscale="log", title=soil.replace("_", " "), xlabel="time of an evaluation [ns]"
        )
        axis.set_xticks([100, 200, 400, 800], ["100", "200", "400", "800"])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest error of the forces / load [-]")
    axes[0].annotate("promise", (0.98, LIMIT), xycoords=("axes fraction", "data"), ha="right", va="bottom")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure, write JSON, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder for the two files")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    results = {soil: measure(soil, 1.0) for soil in ("clay", "dry_sand")}
    for soil, rows in results.items():
        for row in rows:
            print(
                f"{soil:9} {row['rule']:38} {row['ns']:6.0f} ns  largest {row['largest']:.1e}"
                f"  median {row['median']:.1e}"
            )
    partial = folder / "accuracy_cost.json.partial"
    partial.write_text(json.dumps(results, indent=2) + "\n")
    partial.replace(folder / "accuracy_cost.json")
    draw(results, folder / "accuracy_cost.png")


if __name__ == "__main__":
    main()
