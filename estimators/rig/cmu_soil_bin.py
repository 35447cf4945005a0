"""The soil-bin trials of C. Pavlov (Carnegie Mellon University): reading the published file."""

from __future__ import annotations

import io
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from estimators.logs.config import LogConfig
from estimators.logs.log import Log
from estimators.logs.writing import content_hash
from estimators.rig.trials import RigTrials, longitudinal_slip
from offroad_env.errors import DataError
from offroad_env.world.datasets import verify
from offroad_env.world.files import read_file
from offroad_env.world.soils import SOILS
from offroad_env.world.vehicles import make_wheel

__all__ = ["CMU_WHEEL", "cmu_rig_log", "load_cmu_single_wheel"]

#: The wheel of the Carnegie Mellon trials as the base model sees it: the rim, without its 5 mm
#: grousers. The published rim speed is omega times this radius, so slip, geometry and data agree;
#: what grousers add (shear at 0.063 m) is an effect to be found, not to be built into the baseline.
CMU_WHEEL = make_wheel(r=0.058, b=0.050)
#: Longest file that is handed to SciPy's reader [bytes]; the published one has 35 kB.
_LARGEST = 1_000_000


def load_cmu_single_wheel(path: str | PathLike[str], *, published: bool = True) -> RigTrials:
    """Read the soil-bin trials of C. Pavlov (Carnegie Mellon University) from the published file.

    Parameters
    ----------
    path
        ``all_grouser_data.mat`` as published (`offroad_env.world.datasets.fetch` or ``locate``).
    published
        Accept only the published bytes. False reads any intact file with the same records; a
        damaged one can then crash the interpreter, because SciPy's reader trusts its input.

    Returns
    -------
    RigTrials
        189 trials: 7 slip angles x 9 rim speeds x 3 repeats.

    Raises
    ------
    DataError
        When the file is missing, damaged or not this file, naming the field and row.

    Notes
    -----
    The published angle beta turns the travel to the wheel's right (the authors' own model sets
    v_y = -V sin(beta), file run_model.m) and the soil pushes left, so slip_angle = -beta and the
    side force is avg_Fx as it is. Commanded angles are used: the measured ones differ by less
    than 0.3 degrees, and their noise would cross 90.
    """
    path = Path(path)
    if published:
        verify("cmu_single_wheel", path)
    table = _read_cmu_records(path)
    slip_angle = -np.radians(table["beta"])
    travel, rim = table["avg_Vx"] / 1e3, table["avg_Vry"] / 1e3
    labels = np.stack([table["beta"], table["Vry"]])
    return RigTrials(
        slip=longitudinal_slip(rim, travel, slip_angle),
        slip_angle=slip_angle,
        load=-table["avg_Fz"],
        drawbar=-table["avg_Fy"],
        side_force=table["avg_Fx"],
        sinkage=-table["avg_Z"] / 1e3,
        load_sd=table["std_Fz"],
        drawbar_sd=table["std_Fy"],
        side_force_sd=table["std_Fx"],
        sinkage_sd=table["std_Z"] / 1e3,
        travel_speed=travel,
        rim_speed=rim,
        condition=np.unique(labels, axis=1, return_inverse=True)[1].reshape(-1),
    )


def cmu_rig_log(path: str | PathLike[str]) -> Log:
    """The same trials as a log of a wheel rig, with the sand of the plate tests as the prior.

    Raises
    ------
    DataError
        As `load_cmu_single_wheel`.
    """
    trials = load_cmu_single_wheel(path)
    names = ("slip", "slip_angle", "load", "drawbar", "side_force", "sinkage")
    channels = {name: getattr(trials, name).copy() for name in names}
    channels["condition"] = trials.condition.astype(float)
    for array in channels.values():
        array.flags.writeable = False
    config = LogConfig(soil=SOILS["cmu_sand"], wheel=CMU_WHEEL)
    log = Log(name="cmu_single_wheel", t=None, channels=channels, references={}, config=config, hash="")
    return replace(log, hash=content_hash(log))


#: Fields that are read, with the range a value can have on this rig [N, mm, mm/s, deg].
_CMU_FIELDS = {
    "avg_Fx": (-500.0, 500.0),
    "std_Fx": (0.0, 500.0),
    "avg_Fy": (-500.0, 500.0),
    "std_Fy": (0.0, 500.0),
    "avg_Fz": (-500.0, 0.0),
    "std_Fz": (0.0, 500.0),
    "avg_Vx": (1.0, 1000.0),
    "avg_Vry": (0.0, 1000.0),
    "avg_Z": (-500.0, 50.0),
    "std_Z": (0.0, 50.0),
    "beta": (0.0, 90.0),
    "Vry": (0.0, 1000.0),
}


def _read_cmu_records(path: Path) -> dict[str, np.ndarray]:
    from scipy.io import loadmat  # not a cost of importing estimators

    try:
        content = loadmat(io.BytesIO(read_file(path, most=_LARGEST)), squeeze_me=True)
    except DataError:
        raise
    except Exception as error:  # the reader raises a dozen kinds of exception on what is no such file
        raise DataError(f"{path} is not a readable MATLAB file: {type(error).__name__}: {error}") from error
    records = np.atleast_1d(content.get("all_results", np.empty(0)))
    if records.dtype.names is None or records.size == 0:
        raise DataError(
            f"{path} holds no records named all_results (found: "
            f"{', '.join(k for k in content if not k.startswith('__')) or 'nothing'}) - another file?"
        )
    missing = [name for name in _CMU_FIELDS if name not in records.dtype.names]
    if missing:
        raise DataError(f"{path}: the records lack the fields {', '.join(missing)}")
    return {name: _cmu_column(path, name, records[name], *_CMU_FIELDS[name]) for name in _CMU_FIELDS}


def _cmu_column(path: Path, name: str, values: np.ndarray, low: float, high: float) -> np.ndarray:
    column = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            column[row] = value
        except (TypeError, ValueError):
            raise DataError(f"{path}: {name} of record {row + 1} is not a number: {value!r}") from None
        if not low <= column[row] <= high:
            raise DataError(
                f"{path}: {name} of record {row + 1} is {column[row]:g}, outside [{low:g}, {high:g}] "
                "- damaged, or in another unit?"
            )
    return column
