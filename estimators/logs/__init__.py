"""Measured and simulated logs: one format, read strictly, written whole, checked before use.

A log is a CSV or Parquet file with a YAML of the same name, or a ROS bag with such a YAML.
`read_log` refuses impossible files in one sentence; `quality` reports on data that can be read but may
still be wrong; `plant_of`, `start_of` and `commands_at` give what a simulation needs; `Recorder`,
`log_from_run` and `log_of_drive` make logs of simulated runs in the same format.
"""

from __future__ import annotations

from estimators.logs.config import GnssSpec, ImuSpec, LogConfig, StartSpec, TerrainSpec
from estimators.logs.f1tenth import f1tenth_log
from estimators.logs.log import Log
from estimators.logs.quality import ChannelQuality, QualityReport, quality
from estimators.logs.reading import read_log, read_logs
from estimators.logs.runs import (
    Recorder,
    commands_at,
    config_of,
    held,
    log_from_run,
    log_of_drive,
    plant_of,
    start_of,
    truth_of,
    with_structure,
)
from estimators.logs.units import Check, Finding
from estimators.logs.writing import write_log

__all__ = [
    "ChannelQuality",
    "Check",
    "Finding",
    "GnssSpec",
    "ImuSpec",
    "Log",
    "LogConfig",
    "QualityReport",
    "Recorder",
    "StartSpec",
    "TerrainSpec",
    "commands_at",
    "config_of",
    "f1tenth_log",
    "held",
    "log_from_run",
    "log_of_drive",
    "plant_of",
    "quality",
    "read_log",
    "read_logs",
    "start_of",
    "truth_of",
    "with_structure",
    "write_log",
]
