"""``offroad reproduce STUDY``: the studies behind the documentation's figures.

Nothing heavy is imported here: a study is imported only when it is called.
"""

from __future__ import annotations

__all__ = ["STUDIES", "STUDY_ALIASES"]

#: Study -> (folder of agents.studies, name of its argument class, what it shows).
STUDIES: dict[str, tuple[str, str, str]] = {
    "table1": (
        "paper_table",
        "Table1",
        "the paper's table: error of n on eight rows, three sources of the state",
    ),
    "paper_failures": (
        "paper_failures",
        "Causes",
        "why the paper's filter fails where it does: four experiments",
    ),
    "filter_comparison": (
        "filter_comparison",
        "Filters",
        "all filters on the same drives: error, bound, cost",
    ),
    "information_gate": (
        "information_gate",
        "Gate",
        "estimate and sd while the motion tells nothing of the soil",
    ),
    "value_of_n": ("value_of_n", "ValueOfN", "what knowing n is worth, over soils and widths of the prior"),
    "learning": ("learning", "Learning", "trained policies with the estimate, without it, with memory"),
    "ppo_learning_curve": (
        "ppo_learning_curve",
        "PPOLearningCurve",
        "training time until PPO outdoes pure pursuit, by seed",
    ),
    "direct_policies": (
        "direct_policies",
        "DirectPolicies",
        "policies that steer and drive themselves on natural soils, in four arms",
    ),
    "changing_soil": (
        "changing_soil",
        "Changing",
        "n that changes on the way: delay and error of the filters",
    ),
    "detection_delay": (
        "detection_delay",
        "DetectionDelay",
        "what it is worth to detect a change of the soil soon",
    ),
    "prediction": ("prediction", "Prediction", "position error after 10 s with prior, estimated and true n"),
    "online_filters": (
        "online_filters",
        "OnlineFilters",
        "the online filters of the environment: error, interval, cost",
    ),
    "sensors": ("sensors", "Sensors", "what wheel speeds and satellite fixes add to the inertial unit"),
    "fault_detection": (
        "fault_detection",
        "FaultDetection",
        "faults in simulated logs: false alarms, power, sets",
    ),
    "natural_faults": (
        "natural_faults",
        "NaturalFaults",
        "the same in a natural world: scattering soil, tolerances, causes of another form",
    ),
    "rig_fault_detection": (
        "rig_fault_detection",
        "RigFaultDetection",
        "the same on wheel rigs; the measured soil bin",
    ),
    "tyre": (
        "tyres",
        "TyreStudy",
        "the flexible tyre against published stiffness, ruts, resistance and pull",
    ),
    "adaptation": (
        "adaptation",
        "Adaptation",
        "prediction on unseen soils after a few seconds: belief, learned models, oracle",
    ),
    "belief": (
        "belief",
        "BeliefStudy",
        "the soil under drives whose soil is known: errors and coverage of n and phi",
    ),
    "model_mismatch": ("model_mismatch", "Mismatches", "filters whose model is wrong: error, coverage, flag"),
    "closed_loop": (
        "closed_loop",
        "ClosedLoop",
        "what a diagnosis is worth: plans for the nominal, the extended and the true model",
    ),
    "soil_belief": (
        "soil_belief",
        "SoilBelief",
        "what the soil holds when all of the soil is unknown, online",
    ),
}

#: Shorter and former names of studies.
STUDY_ALIASES: dict[str, str] = {
    "paper_table": "table1",  # alias
    "causes": "paper_failures",  # alias
    "filters": "filter_comparison",  # alias
    "gate": "information_gate",  # alias
    "headroom": "value_of_n",  # alias
    "passing": "ppo_learning_curve",  # alias
    "changing": "changing_soil",  # alias
    "promptness": "detection_delay",  # alias
    "carried": "online_filters",  # alias
    "diagnosis": "fault_detection",  # alias
    "rig": "rig_fault_detection",  # alias
    "mismatch": "model_mismatch",  # alias
}
