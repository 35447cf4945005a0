"""``offroad reproduce STUDY``: the studies that stand behind the documentation's figures.

Nothing heavy is imported here: a study is imported only when it is called.
"""

from __future__ import annotations

__all__ = ["STUDIES"]

#: Study -> (module of agents.studies with its argument class, name of that class, what it shows).
STUDIES: dict[str, tuple[str, str, str]] = {
    "table1": ("table1", "Table1", "the paper's table: error of n on eight rows, three sources of the state"),
    "causes": ("causes", "Causes", "why the paper's filter fails where it does: four experiments"),
    "filters": ("filters", "Filters", "all filters on the same twins: error, bound, coverage, cost"),
    "gate": ("gate", "Gate", "an estimate holds and its sd grows while the motion says nothing of the soil"),
    "headroom": ("headroom", "Headroom", "what knowing n is worth, over soils and widths of the prior"),
    "learning": ("learning", "Learning", "trained policies with the estimate, without it, with memory"),
    "passing": ("passing", "Passing", "PPO learns its way past pure pursuit: how soon, by seed"),
    "changing": ("changing", "Changing", "n that changes on the way: how soon the filters answer"),
    "promptness": ("promptness", "Promptness", "what it is worth to learn soon that the soil has changed"),
    "prediction": ("prediction", "Prediction", "position error after 10 s with prior, estimated and true n"),
    "carried": ("carried", "Carried", "the estimators that the environment can carry: error, band, cost"),
    "sensors": ("sensors", "Sensors", "what wheel speeds and satellite fixes add to the inertial unit"),
    "diagnosis": ("diagnosis", "DiagnosisStudy", "hide and find: false alarms, power, sets, wrong names"),
    "rig": ("rig", "RigStudy", "hide and find on wheel rigs; the measured soil bin, angle by angle"),
    "mismatch": ("mismatch", "Mismatches", "filters whose model is wrong: error, coverage, validity flag"),
}
