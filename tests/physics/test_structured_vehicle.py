"""The half-car on wheels of named structures."""

from __future__ import annotations

import numpy as np
import pytest

from offroad_env.physics import state as at
from offroad_env.physics.axle import contact_shape
from offroad_env.physics.equations import full_derivative
from offroad_env.physics.full_jacobian import Slope, axle_stiffnesses
from offroad_env.simulation.fleet import make_fleet, simulate_fleet_commands
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.soils import SOILS
from offroad_env.world.structures import make_structure
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES


@pytest.mark.parametrize("structure", ["grid", "field", "full,pressure_direction=ground_normal"])
def test_wheels_of_any_structure_drive_the_half_car(structure):
    """A rear wheel that follows in a rut rolls deeper; states and contact states stay finite."""
    plant = make_plant(VEHICLES["mrzr"], SOILS["lete_sand"], flat(), structure=structure)
    x, warm = settled_state(plant, v_x=4.0)
    assert warm.shape == contact_shape(plant.structure)
    assert simulate_commands(plant, x, warm, np.zeros((5, 3))).status == 0.0
    commands = np.tile([0.05, 300.0, 0.0], (150, 1))
    run = simulate_commands(plant, x, warm, commands)
    assert np.isfinite(run.states).all()
    again = simulate_commands(plant, x, warm, commands)
    np.testing.assert_array_equal(run.states, again.states)
    halved = simulate_commands(plant, x, warm, commands, dt=0.0025)
    moved = np.hypot(*(halved.states[-1, :2] - run.states[-1, :2]))
    assert moved < 2e-3 * np.hypot(*run.states[-1, :2])


def test_general_wheels_with_the_laws_of_the_preset_drive_as_it_does():
    plain = make_plant(VEHICLES["mrzr"], SOILS["lete_sand"], flat())
    general = plain._replace(structure=make_structure("full"))
    commands = np.tile([0.05, 900.0, 0.0], (100, 1))
    ends = []
    for plant in (plain, general):
        x, warm = settled_state(plant, v_x=4.0)
        ends.append(simulate_commands(plant, x, warm, commands).states[-1])
    assert ends[1] == pytest.approx(ends[0], abs=1e-5, rel=1e-5)


def test_a_fleet_with_ruts_drives_as_its_vehicles_alone():
    plant = make_plant(VEHICLES["mrzr"], SOILS["lete_sand"], flat(), structure="grid")
    x, warm = settled_state(plant, v_x=4.0)
    commands = np.stack([np.tile([steer, 300.0, 0.0], (60, 1)) for steer in (0.0, 0.1)])
    fleet = make_fleet([plant, plant])
    together = simulate_fleet_commands(fleet, x, warm, commands)
    for i in range(2):
        alone = simulate_commands(plant, x, warm, commands[i])
        np.testing.assert_array_equal(together.states[:, i], alone.states)


@pytest.mark.parametrize("vehicle_model", ["half_car", "four_wheel"])
def test_a_shaft_torque_from_outside_unloads_the_front_less(vehicle_model):
    """By T / L = F_x r / L, as the equilibrium of the whole vehicle has it."""
    loads, pulls, v = {}, {}, VEHICLES["mrzr"]
    for shaft in ("reacted", "external"):
        structure = make_structure("grid", shaft_torque=shaft)
        plant = make_plant(v, SOILS["lete_sand"], flat(), structure=structure, vehicle_model=vehicle_model)
        x, warm = settled_state(plant, v_x=3.0)
        run = simulate_commands(plant, x, warm, np.tile([0.0, 1500.0, 0.0], (60, 1)))
        front, rear = run.readings[-25:, : at.AXLE], run.readings[-25:, at.AXLE : 2 * at.AXLE]
        loads[shaft] = front[:, at.N].mean()
        pulls[shaft] = (front[:, at.F_L] + rear[:, at.F_L]).mean()
    expected = v.r * pulls["external"] / (v.l_f + v.l_r)
    less = (pulls["reacted"] - pulls["external"]) * v.h_cg / (v.l_f + v.l_r)
    assert loads["external"] - loads["reacted"] == pytest.approx(expected + less, rel=0.1)


def test_a_slip_about_to_change_its_sign_is_as_stiff_as_what_the_step_meets():
    """Where slip changes its sign, the torque grows like its root: the tangent before says nothing."""
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], flat(), structure="grid")
    x, warm = settled_state(plant, v_x=3.3)
    x[at.OMEGA_F] = 0.997 * 3.3 / plant.vehicle.r
    slope, readings = np.zeros(at.STATE_SIZE), np.zeros(at.READINGS_SIZE)
    full_derivative(x, (0.0, 0.0, 0.0), plant, warm, slope, readings)
    found = []
    for gain in (0.0, 40.0):
        slope[at.OMEGA_F], stiffness = gain, np.zeros(at.READINGS_SIZE)
        axle_stiffnesses(plant, x, warm, readings, Slope(slope, 0.005), stiffness)
        found.append(stiffness[0])
    tangent, secant = found
    assert secant > 2.0 * tangent > 0.0
