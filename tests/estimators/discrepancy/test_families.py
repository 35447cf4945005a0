"""Families of causes: what a verdict can be held to where variants of a law cannot be told apart."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from estimators.discrepancy.families import DRIVE_FAMILIES, RIG_FAMILIES, families_of
from estimators.discrepancy.faults.other_forms import FAMILIES
from estimators.discrepancy.summary import CauseMember, CauseSummary
from estimators.discrepancy.verdict import VehicleDiagnosis, Verdict
from estimators.discrepancy.wording import verdict_sentence
from offroad_env.effects import EFFECTS


def test_every_effect_that_may_be_named_has_one_family_where_it_acts():
    for effect in EFFECTS.values():
        if effect.searched and "full" in effect.models:
            assert len(families_of([effect.id], DRIVE_FAMILIES)) == 1, effect.id
        if effect.searched and "rig" in effect.models:
            assert len(families_of([effect.id], RIG_FAMILIES)) == 1, effect.id
    assert {name for own in DRIVE_FAMILIES.values() for name in own} <= set(EFFECTS)


@pytest.mark.parametrize("fault", FAMILIES)
def test_the_study_s_families_are_no_wider_than_those_of_the_verdict(fault):
    """What counts as the right family of a hidden cause is one family of a verdict."""
    assert len(families_of(FAMILIES[fault], DRIVE_FAMILIES)) == 1


def _cause(*effects: str, families: tuple[str, ...]) -> CauseSummary:
    members = tuple(
        CauseMember(
            effect=effect,
            size=0.1,
            deviation=0.01,
            low=0.08,
            high=0.12,
            lacks_loglik=0.0,
            sentence=EFFECTS[effect].describe(0.1),
            phrase=EFFECTS[effect].describe(0.1),
        )
        for effect in effects
    )
    return CauseSummary(
        members=members,
        parameters=(),
        p_value=1e-9,
        delta_loglik=40.0,
        named=True,
        joint=None,
        families=families,
    )


def test_one_family_is_named_before_its_variants_and_several_are_not():
    diagnosis = VehicleDiagnosis(
        search=SimpleNamespace(refused=False, capped=False, strayed=(), uncertain=()),
        checks=SimpleNamespace(overlap=0.0),
    )
    one = _cause("steer_delay", "steer_lag", families=("late steering",))
    several = replace(one, families=("late steering", "clocks of inputs and sensors"))
    sentence = verdict_sentence(Verdict.ONE_OF, diagnosis, [one])
    assert sentence.startswith("Late steering, one of: the steering acts 0.1 s later than logged; or the")
    assert verdict_sentence(Verdict.ONE_OF, diagnosis, [several]).startswith("One of: the steering acts")
