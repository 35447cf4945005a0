"""Habits of other people's loggers: each is read right, or named as what it is."""

from __future__ import annotations

import math
import unicodedata

import numpy as np
import pytest
from foreign_logs import Foreign, drive, write

from estimators.logs import quality, read_log
from estimators.logs.checking.check import check_log
from estimators.logs.checking.names import name_remarks
from estimators.logs.checking.naming import column_of
from estimators.logs.schema import VEHICLE_INPUTS
from estimators.logs.substitutes import substituted
from estimators.logs.unit_conversion import conversion
from mended_logs import IMU, PLAIN
from offroad_env.errors import DataError, InvalidParameter

# ------------------------------------------------------------------ driving in reverse


def _reverse(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same speeds backwards: all signs right, the speed over ground without one, no v_x."""
    made = dict(channels)
    for name in ("omega_f", "omega_r", "torque_f", "torque_r", "a_x", "yaw_rate", "v_x"):
        made[name] = -made[name]
    yaw = 0.6 - channels["yaw"]
    step = made["v_x"] * np.gradient(channels["t"])
    made |= {"x": 40.0 + np.cumsum(step * np.cos(yaw)), "y": 40.0 + np.cumsum(step * np.sin(yaw))}
    return made | {"yaw": yaw, "speed": np.abs(made["v_x"]), "course": yaw + math.pi}


_GROUND = {name: name for name in (*PLAIN, *IMU, "speed") if name != "v_x"}


def _with_speed(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return channels | {"speed": np.abs(channels["v_x"])}


def test_a_drive_in_reverse_with_right_signs_gets_no_line(tmp_path):
    report = check_log(write(tmp_path, Foreign(names=_GROUND | {"course": "course"}, change=_reverse)))
    assert report.lines == ()
    assert report.quality is not None
    assert not report.quality.problems


def test_wheels_with_a_reversed_sign_are_still_named(tmp_path):
    def turned(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        made = _with_speed(channels)
        return made | {"omega_r": -made["omega_r"]}

    report = check_log(write(tmp_path, Foreign(names=_GROUND, change=turned)))
    assert "the sign of omega_r is reversed" in " ".join(remark.sentence for remark in report.remarks)


def test_a_log_that_begins_in_reverse_starts_backwards(tmp_path):
    names = {name: name for name in _GROUND if name != "yaw"} | {"course": "course"}
    log = read_log(write(tmp_path, Foreign(names=names, change=_reverse)))
    start = log.config.start
    assert start is not None
    assert start.v_x < -3.0
    assert math.cos(start.yaw - 0.3) > 0.99


def test_a_missing_lateral_acceleration_takes_the_direction_of_the_wheels(tmp_path):
    names = {name: name for name in _GROUND if name != "a_y"}
    way = Foreign(names=names, change=_reverse)
    log, _ = substituted(read_log(write(tmp_path, way)))
    expected = way.change(drive())["a_y"]
    assert np.corrcoef(log.channels["a_y"], expected)[0, 1] > 0.9


# ------------------------------------------------------------------ places, torques, units


def _with_fixes(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Places at 60 degrees north; nothing is received in the first two seconds."""
    north = 60.0 + np.degrees(channels["y"] / 6.4e6)
    east = 11.0 + np.degrees(channels["x"] / (6.4e6 * 0.5))
    none = channels["t"] < 2.0
    return channels | {"latitude": np.where(none, 0.0, north), "longitude": np.where(none, 0.0, east)}


_FIXES = {name: name for name in (*PLAIN, *IMU, "latitude", "longitude") if name not in ("x", "y")}


@pytest.mark.parametrize("lost", [0.0, 1.0])
def test_a_place_at_0_0_or_far_away_is_not_where_the_drive_began(tmp_path, lost):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        made = _with_fixes(channels)
        return made | {"latitude": np.where(channels["t"] < 2.0, 20.0 * lost, made["latitude"])}

    log = read_log(write(tmp_path, Foreign(names=_FIXES, change=change, digits=12)))
    true = drive()
    late = log.times > 2.0
    moved = np.ptp(log.channels["x"][late & np.isfinite(log.channels["x"])])
    assert moved == pytest.approx(np.ptp(true["x"][true["t"] > 2.0]), rel=0.01)
    if not lost:
        assert np.isnan(log.channels["x"][~late][:-1]).all()
        assert "0, 0 in 100 rows" in " ".join(log.config.notes)
        sentences = " ".join(remark.sentence for remark in check_log(tmp_path / "run.csv").remarks)
        assert "0, 0 in 100 rows" in sentences


_TOTAL = {n: n for n in (*PLAIN, *IMU, "omega_f", "torque_total") if n not in ("torque_f", "torque_r")}


@pytest.mark.parametrize("backwards", [False, True])
def test_a_total_torque_is_split_as_it_brakes(tmp_path, backwards):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        made = _reverse(channels) if backwards else dict(channels)
        way = -1.0 if backwards else 1.0
        return made | {"torque_total": way * 2000.0 * np.cos(0.7 * channels["t"] + 0.4)}

    path = write(tmp_path, Foreign(names=_TOTAL, change=change))
    settings = tmp_path / "run.yaml"
    settings.write_text(settings.read_text() + "vehicle.drive_front: 0\nvehicle.brake_front: 0.65\n")
    log = read_log(path)
    front, rear = log.channels["torque_f"], log.channels["torque_r"]
    brakes = (front + rear) * (-1.0 if backwards else 1.0) < 0.0
    assert brakes.any()
    np.testing.assert_allclose(front, np.where(brakes, 0.65, 0.0) * (front + rear), atol=1e-9)
    assert log.config.vehicle.drive_front == 0.0
    named = [finding for finding in quality(log).findings if "torque_f" in finding.sentence]
    assert not [finding for finding in named if finding.severity == "problem"]
    assert all("torque_total" in finding.sentence for finding in named if finding.channel == "torque_f")


@pytest.mark.parametrize(
    ("column", "unit", "factor"),
    [
        ("omega_f", "min^-1", math.pi / 30.0), ("omega_f", "min⁻¹", math.pi / 30.0),
        ("omega_f", "U/min", math.pi / 30.0), ("omega_f", "tr/min", math.pi / 30.0),
        ("omega_f", "kHz", 2000.0 * math.pi), ("omega_f", "1/s", 2.0 * math.pi),
        ("yaw_rate", "mdeg/s", math.radians(1e-3)), ("yaw_rate", "Grad/s", math.radians(1.0)),
        ("steer", "Grad", math.radians(1.0)), ("steer", "turn", 2.0 * math.pi),
    ],
)  # fmt: skip
def test_a_rate_per_time_counts_turns(column, unit, factor):
    assert conversion(unit, VEHICLE_INPUTS[column]).factor == pytest.approx(factor)


@pytest.mark.parametrize(
    ("column", "unit"), [("omega_f", "counts/s"), ("omega_f", "%/s"), ("steer", "counts")]
)
def test_counts_are_no_angle(column, unit):
    with pytest.raises(InvalidParameter, match="must be a unit of ang"):
        conversion(unit, VEHICLE_INPUTS[column])


def test_a_unit_in_the_name_of_a_mapped_column_is_taken(tmp_path):
    names = {**{n: n for n in (*PLAIN, *IMU)}, "v_x": "Tempo [km/h]", "omega_r": "Rad [U/min]"}
    path = write(tmp_path, Foreign(names=names))
    settings = tmp_path / "run.yaml"
    mapped = 'columns: {speed: "Tempo [km/h]", omega_r: "Rad [U/min]"}\n'
    settings.write_text(settings.read_text() + mapped)
    lines = {str(line) for line in check_log(path).lines}
    assert {"units.speed: km/h", "units.omega_r: U/min"} <= lines


# ------------------------------------------------------------------ cells that are no samples


@pytest.mark.parametrize("mark", ["-9999", "-1e6", "--"])
def test_cells_that_are_mostly_no_samples_are_named_and_nothing_else(tmp_path, mark):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        slow = np.arange(len(channels["t"])) % 20 == 0
        return _with_speed(channels) | {"speed": np.where(slow, channels["v_x"], math.nan)}

    def text(rows: str) -> str:
        return "\n".join(row + mark if row.endswith(",") else row for row in rows.splitlines()) + "\n"

    path = write(tmp_path, Foreign(names={**PLAIN, **IMU, "speed": "speed"}, change=change, text=text))
    assert [str(line) for line in check_log(path).lines] == [f'csv.missing: ["{mark}"]']


def test_thousands_separators_are_called_so(tmp_path):
    def text(rows: str) -> str:
        head, *rest = rows.splitlines()
        return "\n".join(
            [f"{head},torque_total", *(f'{row},"1,43{i % 10}.98"' for i, row in enumerate(rest))]
        )

    names = {name: name for name in (*PLAIN, *IMU) if not name.startswith("torque")}
    path = write(tmp_path, Foreign(names=names, text=text))
    report = check_log(path)
    assert not any(line.key == "csv.missing" for line in report.lines)
    assert "'torque_total' has thousands separators ('1,430.98')" in " ".join(
        r.sentence for r in report.remarks
    )
    with pytest.raises(DataError, match="has a thousands separator"):
        read_log(path)


# ------------------------------------------------------------------ clocks


@pytest.mark.parametrize(
    ("name", "unit", "scale"),
    [
        ("Zeit [ms]", "ms", 1e3), ("horodatage_ns", "ns", 1e9), ("TOW (ms)", "ms", 1e3),
        ("timestamp_ns", "ns", 1e9), ("gps_tow [s]", None, 1.0), ("Zeitstempel", None, 1.0),
        ("Takt [us]", "us", 1e6),
    ],
)  # fmt: skip
def test_a_clock_is_recognised_by_its_name_or_its_numbers(tmp_path, name, unit, scale):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return channels | {"t": scale * (1000.0 + channels["t"])}

    path = write(tmp_path, Foreign(names={**PLAIN, **IMU, "t": name}, change=change, digits=17))
    found = {line.key: line.value for line in _named_lines(path)}
    assert found.get("columns.t") == name
    assert found.get("units.t") == unit


_GERMAN = {
    "Lenkwinkel": "steer", "Giergeschwindigkeit": "yaw_rate", "Längsbeschleunigung": "a_x",
    "Querbeschleunigung": "a_y", "Vertikalbeschleunigung": "a_z", "Nickrate": "pitch_rate",
    "Wankwinkel": "roll", "Gierwinkel": "yaw", "Raddrehzahl vorne links": "omega_fl",
    "Raddrehzahl_HR": "omega_rr", "Antriebsmoment Hinterachse": "torque_r", "Fahrgeschwindigkeit": "speed",
    "Breitengrad": "latitude", "Kurs": "course", "Motordrehzahl": None, "Bremsdruck": None, "Rad": None,
}  # fmt: skip
_FRENCH = {
    "angle_braquage": "steer", "vitesse_lacet": "yaw_rate", "accélération longitudinale": "a_x",
    "acceleration_laterale": "a_y", "tangage": "pitch", "vitesse roue arrière gauche": "omega_rl",
    "vitesse_roue_AVD": "omega_fr", "couple avant": "torque_f", "vitesse": "speed", "cap": "yaw",
    "régime moteur": None, "pression de frein": None, "arg": None, "régime roue avant gauche": "omega_fl",
    "vitesse arg roue": "omega_rl", "cap lacet": "yaw",
}  # fmt: skip
#: Words of one language, or short ones, that would be others in the other.
_ALIKE = {
    "vitesse_avg": "speed", "vitesse arg": "speed", "battery_cap": None, "tire_cap": None, "regime": None,
    "flow_regime": None, "tire_temps": None, "temps": "t", "Geschwindigkeit_hr": "speed",
    "Fahrgeschwindigkeit avg": "speed", "Raddrehzahl avg": "omega", "Antriebsmoment_HL": "torque_rl",
    "vitesse roue hr": "omega",
}  # fmt: skip


@pytest.mark.parametrize(("name", "column"), [*_GERMAN.items(), *_FRENCH.items(), *_ALIKE.items()])
@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_german_and_french_names_are_understood(name: str, column: str | None, form: str) -> None:
    assert column_of(unicodedata.normalize(form, name)) == column


def _named_lines(path):
    remarks = name_remarks(path, path.with_suffix(".yaml").read_text())
    return [line for remark in remarks for line in remark.lines]


@pytest.mark.parametrize("period", [86_400.0, 604_800.0])
@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_a_clock_that_begins_anew_goes_on(tmp_path, period, scale):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return channels | {"t": scale * np.mod(period - 6.0 + channels["t"], period)}

    path = write(tmp_path, Foreign(names={**PLAIN, **IMU}, change=change, digits=12))
    if scale > 1.0:
        settings = tmp_path / "run.yaml"
        settings.write_text(settings.read_text() + "units.t: ms\n")
    log = read_log(path)
    assert len(log) == len(drive()["t"])
    assert log.duration == pytest.approx(np.ptp(drive()["t"]))


def test_a_date_in_another_format_names_the_one_that_is_read(tmp_path):
    def text(rows: str) -> str:
        head, *rest = rows.splitlines()
        dated = [f"10.06.2024 12:00:{i % 60:02d}.000,{row}" for i, row in enumerate(rest)]
        return "\n".join([f"Zeit,{head}", *dated])

    names = {name: name for name in (*PLAIN, *IMU) if name != "t"}
    path = write(tmp_path, Foreign(names=names, text=text))
    assert [str(line) for line in _named_lines(path)] == ["columns.t: Zeit"]
    settings = tmp_path / "run.yaml"
    settings.write_text(settings.read_text() + "columns.t: Zeit\n")
    with pytest.raises(DataError, match="ISO 8601"):
        read_log(path)


# ------------------------------------------------------------------ angles, reasons


def test_an_angle_of_the_steering_wheel_in_rad_stays_in_rad(tmp_path):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return channels | {"steer": 15.6 * channels["steer"]}

    names = {**PLAIN, **IMU, "steer": "Steering Wheel Angle (rad)"}
    lines = {
        line.key: line.value for line in check_log(write(tmp_path, Foreign(names=names, change=change))).lines
    }
    assert lines["units.steer"] == "0.0625 rad"


def test_channels_that_contradict_each_other_are_not_said_to_rest(tmp_path):
    def change(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        rng = np.random.default_rng(5)
        made = dict(channels)
        for name, size in (("a_x", 2.0), ("torque_f", 900.0), ("torque_r", 900.0)):
            made[name] = size * np.repeat(rng.standard_normal(len(made["t"]) // 25 + 1), 25)[: len(made["t"])]
        return made

    log = read_log(write(tmp_path, Foreign(names={**PLAIN, **IMU}, change=change)))
    unchecked = {f.channel: f.sentence for f in quality(log).findings if f.kind == "unchecked"}
    assert "hardly changed" not in " ".join(unchecked.values())
