"""Which YAML describes which data file: ``run.yaml`` beside ``run.csv``, or ``run.csv.yaml`` for it alone."""

from __future__ import annotations

from pathlib import Path

from estimators.logs.schema import DATA_ENDINGS
from offroad_env.errors import DataError

__all__ = ["description_to_write", "find_description", "shared_description"]

_ENDINGS = (".yaml", ".yml")


def shared_description(path: Path) -> Path:
    """The YAML of the same name: all data files of that name are described by it, unless one has its own."""
    base = path if path.is_dir() else path.with_suffix("")
    return base.with_name(base.name + ".yaml")


def find_description(path: Path) -> Path:
    """The YAML that describes a data file: its own, else that of its name.

    Raises
    ------
    DataError
        If there is none, or two of the same kind.
    """
    shared = shared_description(path)
    for present in (_present(_own_description(path)), _present(shared)):
        if len(present) == 2:
            raise DataError(
                f"{path}: has two descriptions, {present[0].name} and {present[1].name}: keep one"
            )
        if present:
            return present[0]
    raise DataError(
        f"{path}: its description {shared.name} is missing: a log needs a YAML of the same name "
        "(vehicle, soil, terrain, imu, start): offroad log template VEHICLE writes one"
    )


def description_to_write(path: Path, content: bytes) -> Path:
    """Where the description of a data file goes without changing what another one is described by.

    ``content`` is what will stand there: several files of one name may share what they agree on.
    """
    own, shared = _own_description(path), shared_description(path)
    if _present(own):
        return _present(own)[0]
    present = _present(shared)
    if any(found.suffix != ".yaml" for found in present):
        return own  # a second one of the same kind would make the log unreadable
    others = [path.with_suffix(ending) for ending in DATA_ENDINGS if ending != path.suffix.lower()]
    describes_another = any(other.exists() and not _present(_own_description(other)) for other in others)
    return own if present and describes_another and shared.read_bytes() != content else shared


def _own_description(path: Path) -> Path:
    return path.with_name(f"{path.name}.yaml")


def _present(description: Path) -> list[Path]:
    """Those that exist of the two spellings of the ending."""
    spellings = (description.with_suffix(ending) for ending in _ENDINGS)
    return [spelling for spelling in spellings if spelling.is_file()]
