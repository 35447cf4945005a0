"""What the quality report says of a vehicle that gets stuck."""

from __future__ import annotations

from estimators.logs.immobile import driven_time, stuck_spans
from estimators.logs.log import Log
from estimators.logs.units import Finding

__all__ = ["IMMOBILE", "hardly_driven", "stuck_findings"]

#: Kind of a finding by which a vehicle is stuck.
IMMOBILE = "immobile"
#: Least time of driving that is diagnosed [s]: two windows, each after its lead-in.
_LEAST = 6.0


def hardly_driven(finding: Finding) -> bool:
    """Whether by this finding a vehicle gets stuck so soon that nothing is left to be diagnosed."""
    return finding.kind == IMMOBILE and finding.numbers["driven"] < _LEAST


def stuck_findings(log: Log) -> list[Finding]:
    """That the vehicle gets stuck: no problem of the data, even where hardly anything is driven."""
    spans = stuck_spans(log)
    if not spans:
        return []
    driven, more = driven_time(log), "" if len(spans) == 1 else f" (the first of {len(spans)} times)"
    then = (
        f"only the other {driven:.3g} s are used"
        if driven >= _LEAST
        else f"{driven:.2g} s of driving are left, and a diagnosis needs {_LEAST:g} s"
    )
    return [
        Finding(
            kind=IMMOBILE,
            channel="t",
            severity="warning",
            sentence=(
                f"the vehicle gets stuck: from t = {spans[0][0]:.1f} to {spans[0][1]:.1f} s{more} it stands "
                f"though its wheels are driven; {then}"
            ),
            numbers={"driven": driven, "from": spans[0][0], "to": spans[0][1], "times": float(len(spans))},
        )
    ]
