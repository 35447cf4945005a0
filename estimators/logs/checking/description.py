"""Findings about the description of the vehicle, soil and sensors: all at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from estimators.logs.bags import parse_topics
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.config_parsing import parse_config
from estimators.logs.file_keys import parse_file_keys
from estimators.logs.reading import parse_description
from estimators.logs.schema import nearest
from estimators.logs.yaml_sections import KeyedError, Section
from offroad_env.errors import DataError

__all__ = ["description_remarks", "stand_in", "without_section"]

#: Lines for sections that are missing, each with what it states. Vehicle and soil are the user's to choose.
_MISSING = (
    ("model", "full", "the model", ""),
    ("drivetrain", "torque", "what the inputs are: torque, or force", ""),
    ("vehicle", {"base": "mrzr"}, "the vehicle", " - put your own there: offroad log template VEHICLE"),
    ("soil", {"base": "dry_sand"}, "the prior of the soil", " - put your own there: offroad soil --list"),
    ("terrain", {"kind": "flat"}, "the ground", ""),
    ("imu", {"kinematic": False, "sd": {"a": 0.2, "rate": 0.01}}, "the IMU", ""),
    ("start", "log", "the start", ": taken from the first samples"),
)
#: The same for what a section about the IMU must hold.
_MISSING_INSIDE = {
    "imu": (
        ("kinematic", False, "false where a_z reads 9.81 at rest, true where gravity is taken out"),
        ("sd", {"a": 0.2, "rate": 0.01}, "the noise of a sample [m/s^2, rad/s]"),
    ),
    "imu.sd": (
        ("a", 0.2, "the noise of a sample of an acceleration [m/s^2]"),
        ("rate", 0.01, "the noise of a sample of a rate [rad/s]"),
    ),
}
_MOST_ERRORS = 30


def stand_in() -> str:
    """A description in place of one that is missing."""
    return "".join(f"{Line(key, value)}\n" for key, value, _, _ in _MISSING)


def description_remarks(text: str, file: str, put_in: Callable[[Sequence[Line]], None]) -> list[Remark]:
    """Everything that is wrong with a description; ``put_in`` takes values by which the check can go on."""
    try:
        top = parse_description(text.encode(), file)
    except DataError as error:
        put_in([])
        return [Remark(severity="problem", sentence=str(error))]
    if "wheel" in top:
        return _errors(text, file, put_in, rig=True)
    remarks = []
    for key, value, meaning, more in _MISSING:
        if key not in top:
            sentence = f"{file}: {key} is missing: {meaning}{more}"
            remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line(key, value),)))
    remarks += _missing_of_imu(top)
    added = "".join(f"{line}\n" for remark in remarks for line in remark.lines)
    return remarks + _errors(f"{text.rstrip()}\n{added}", file, put_in, rig=False)


def _missing_of_imu(top: Section) -> list[Remark]:
    """Keys that the sections of an IMU lack; no line for one that may be there misspelt."""
    imu = top.peek("imu")
    given = {"imu": imu, "imu.sd": imu.get("sd") if isinstance(imu, dict) else None}
    remarks = []
    for section, keys in _MISSING_INSIDE.items():
        inner = given[section]
        if not isinstance(inner, dict):
            continue
        for key, value, meaning in keys:
            if key not in inner and nearest(key, map(str, inner)) is None:
                path = f"{section}.{key}"
                sentence = str(top.error(f"{path} is missing: {meaning}", section))
                remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line(path, value),)))
    return remarks


def _errors(text: str, file: str, put_in: Callable[[Sequence[Line]], None], *, rig: bool) -> list[Remark]:
    """Refusals one after the other: each refused value is replaced by that of the stand-in."""
    remarks: list[Remark] = []
    replaced: list[Line] = []
    standing = parse_description(stand_in().encode(), "")
    for _ in range(_MOST_ERRORS):
        try:
            top = parse_description((text + "".join(f"{line}\n" for line in replaced)).encode(), file)
            _parse(top, rig)
            break
        except KeyedError as error:
            remarks.append(Remark(severity="problem", sentence=str(error)))
            section = error.path.split(".")[0]
            if section not in standing or any(line.key == section for line in replaced) or rig:
                break
            # The whole section: one wrong value may not fit the others' stand-ins.
            replaced.append(Line(section, standing.peek(section)))
            text = without_section(text, section)
        except DataError as error:
            remarks.append(Remark(severity="problem", sentence=str(error)))
            break
    put_in(replaced)
    return remarks


def _parse(top: Section, rig: bool) -> None:
    parse_file_keys(top)
    if "topics" in top:
        parse_topics(top)
    parse_config(top, rig=rig)


def without_section(text: str, section: str) -> str:
    """The YAML without a top section; its dotted lines go with it."""
    kept, inside = [], False
    for line in text.splitlines(keepends=True):
        if line[:1] not in (" ", "\t", "-", "#", "\n", "\r"):
            inside = line.startswith((f"{section}:", f"{section}."))
        if not inside:
            kept.append(line)
    return "".join(kept)
