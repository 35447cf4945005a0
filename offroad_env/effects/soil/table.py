"""Uncertain parameters of soil and of hard ground, one row an effect."""

from __future__ import annotations

from functools import partial

from offroad_env.effects.protocol import Effect, Parameter, Setup
from offroad_env.physics.numerics import GRAVITY

__all__ = ["TABLE"]

_row = partial(Effect, hook="parameter", soil_only=True)

#: Smallest and largest angle of internal friction that an effect may lead to [rad].
_PHI_LOW, _PHI_HIGH = 0.01, 1.2
_EVERYWHERE = ("full", "paper", "rig")


def _stronger(setup: Setup, angle: float) -> Setup:
    return setup.with_soil(phi=min(max(setup.plant.soil.phi + angle, _PHI_LOW), _PHI_HIGH))


def _slower_shear(setup: Setup, share: float) -> Setup:
    soil, factor = setup.plant.soil, 1.0 + share
    return setup.with_soil(k_x=factor * soil.k_x, k_y=factor * soil.k_y)


def _stiffer(setup: Setup, share: float) -> Setup:
    soil, factor = setup.plant.soil, 1.0 + share
    return setup.with_soil(k_c=factor * soil.k_c, k_phi=factor * soil.k_phi)


TABLE = (
    _row(
        id="cohesion",
        family="wheel",
        size=Parameter(name="stress", unit="Pa", low=-1e5, high=5e5),
        plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * vehicle.r * vehicle.b),
        sentence="the cohesion is {size} larger",
        source="definition: shift of c in the Mohr-Coulomb criterion",
        look_alikes=("friction_angle", "grouser_thrust"),
        separated_by="a shear box, or trials at several loads",
        models=_EVERYWHERE,
        change=lambda setup, stress: setup.with_soil(c=max(setup.plant.soil.c + stress, 0.0)),
    ),
    _row(
        id="exit_angle",
        family="wheel",
        size=Parameter(name="share", unit="-", low=-0.6, high=0.6),
        plausible=lambda vehicle: 0.2,
        sentence="the exit angle is {size} of the entry angle larger",
        source="definition: shift of b_0 in theta_r = (b_0 + b_1 s) theta_f",
        look_alikes=("n_step", "payload"),
        separated_by="wheel tests with a pressure cell",
        models=_EVERYWHERE,
        change=lambda setup, share: setup.with_soil(b_0=setup.plant.soil.b_0 + share),
    ),
    _row(
        id="friction_angle",
        family="wheel",
        size=Parameter(name="angle", unit="rad", low=-0.5, high=0.6),
        plausible=lambda vehicle: 0.15,
        sentence="the angle of internal friction is {size} larger",
        source="definition: shift of phi in the Mohr-Coulomb criterion",
        look_alikes=("grouser_thrust", "shear_modulus"),
        separated_by="a shear box",
        models=_EVERYWHERE,
        change=_stronger,
    ),
    _row(
        id="peak_angle",
        family="wheel",
        size=Parameter(name="share", unit="-", low=-0.9, high=0.8),
        plausible=lambda vehicle: 0.2,
        sentence="the largest pressure lies {size} of the entry angle further ahead",
        source="definition: shift of a_0 in theta_m = (a_0 + a_1 s) theta_f of Wong & Reece (1967)",
        look_alikes=("exit_angle", "front_bulldozing"),
        separated_by="wheel tests with a pressure cell",
        models=("rig",),
        change=lambda setup, share: setup.with_soil(a_0=setup.plant.soil.a_0 + share),
    ),
    _row(
        id="road_grip",
        family="lateral",
        size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
        plausible=lambda vehicle: 0.3,
        sentence="the friction coefficient of the ground is {size} of its value larger",
        source="definition: scale factor of the friction coefficient of hard ground",
        look_alikes=("steer_gain", "front_grip"),
        separated_by="turns at the limit of what the tyres hold",
        soil_only=False,
        hard_only=True,
        change=lambda setup, share: setup.with_soil(mu=(1.0 + share) * setup.plant.soil.mu),
    ),
    _row(
        id="shear_modulus",
        family="wheel",
        size=Parameter(name="share", unit="-", low=-0.9, high=10.0),
        plausible=lambda vehicle: 1.0,
        sentence="the shear moduli are {size} of their value larger",
        source="definition: scale factor of K in the shear law of Janosi & Hanamoto (1961)",
        look_alikes=("friction_angle", "steer_gain"),
        separated_by="steady pulls at several slips",
        models=_EVERYWHERE,
        change=_slower_shear,
    ),
    _row(
        id="soil_stiffness",
        family="soil",
        size=Parameter(name="share", unit="-", low=-0.95, high=20.0),
        plausible=lambda vehicle: 1.0,
        sentence="the sinkage moduli are {size} of their value larger",
        source="definition: scale factor of k_c and k_phi in Bekker's pressure-sinkage law",
        look_alikes=("load_scale", "sinkage_offset"),
        separated_by="trials at several loads",
        models=("rig",),
        change=_stiffer,
    ),
)
