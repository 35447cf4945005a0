"""The page of a replay: which model predicts best, the drive, and how the errors grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.reports.log_playback import log_playback
from agents.reports.page import PageVerdict, Picture, Section, Table, render_page
from estimators.logs.log import Log
from estimators.replay.replay import Replay, WindowReplay, grid_of
from estimators.replay.structures import Case, plant_for, title_of
from offroad_env.errors import OffroadError

__all__ = ["drive_section", "render_replay"]

#: Channels whose errors are played back: name -> (title, unit).
_PLAYED = {
    "position": ("error of the predicted position", "m"),
    "yaw_rate": ("error of the predicted rate of turn", "rad/s"),
    "v_x": ("error of the predicted speed", "m/s"),
}


def drive_section(
    log: Log, cases: Sequence[Case], *, window: float, hold: str | None, command: str
) -> Section:
    """A log played back, with where in the drive each model errs."""
    return Section(
        name="drive",
        title=f"The drive: {log.name}",
        sees="Where the vehicle went, what was measured, and where in the drive each model errs.",
        playback=log_playback(log, more=_errors(log, cases, window, hold)),
        command=command,
        notes=("Errors begin anew with each window; nothing is drawn within the lead-in of the first one.",),
    )


def render_replay(
    groups: Sequence[Replay], drive: Section, table: Table, picture: Picture, *, window: float, footer: str
) -> str:
    """The page as HTML text."""
    errors = Section(
        name="errors",
        title="Errors of the models",
        sees=f"Windows of {window:g} s, predicted from steering and torques alone; nothing is fitted.",
        tables=(table,),
        pictures=(picture,),
    )
    return render_page(
        (errors, drive),
        title="OffroadBekker: which model predicts the drive?",
        intro="Each model gets the logged steering and torques and predicts what the vehicle does.",
        footer=footer,
        verdict=_verdict(groups, window),
    )


def _verdict(groups: Sequence[Replay], window: float) -> PageVerdict:
    """Which model predicts the position best, and by how much."""
    known = [group for group in groups if np.isfinite(group.rms["position"])]
    if not known:
        return PageVerdict(light="problem", sentence="No model could be compared: every window failed.")
    known.sort(key=lambda group: group.rms["position"])
    best, worst = known[0], known[-1]
    sentence = (
        f"The position is predicted best by {title_of(best.structure)} with the vehicle model "
        f"{best.vehicle_model}: an error of {best.rms['position']:.2g} m over windows of {window:g} s"
    )
    if worst is not best:
        sentence += f", against {worst.rms['position']:.2g} m by {title_of(worst.structure)}"
    failed = sum(group.failed for group in groups)
    if failed:
        sentence += f"; {failed} windows could not be predicted"
    return PageVerdict(light="caution" if failed else "neutral", sentence=f"{sentence}.")


def _errors(
    log: Log, cases: Sequence[Case], window: float, hold: str | None
) -> list[tuple[str, str, dict[str, np.ndarray]]]:
    """Charts of the errors over the time of the log."""
    replay, t = WindowReplay(log, window, hold=hold), grid_of(log)
    charts: dict[str, dict[str, np.ndarray]] = {name: {} for name in _PLAYED}
    for structure, vehicle_model in cases:
        try:
            found = replay.errors(plant_for(log, Case(structure, vehicle_model)))
        except OffroadError:  # the table states which windows failed
            continue
        for name, lines in charts.items():
            row = np.full(t.shape, np.nan)
            row[replay.instants.ravel()] = found[name].ravel()
            lines[f"{title_of(structure)}, {vehicle_model.replace('_', ' ')}"] = row
    return [(title, unit, charts[name]) for name, (title, unit) in _PLAYED.items() if charts[name]]
