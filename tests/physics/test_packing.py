"""The packed plant and the kernel cache."""

from __future__ import annotations

import shutil

import numpy as np

from helpers import REPOSITORY, run_fresh
from offroad_env.physics._jit import kernel
from offroad_env.physics.packing import pack, unpack
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import paper_terrain, soil_map
from offroad_env.world.vehicles import VEHICLES


def _plant():
    patches = soil_map([(3.0, 1.0, 2.0, 0.6)], edge=0.4)
    return make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], paper_terrain(0.04), slip=0.02, soil_map=patches)


@kernel
def _round_trip(packed):
    return unpack(packed)


def test_a_packed_plant_comes_back_as_it_was():
    plant = _plant()
    back = _round_trip(pack(plant))
    assert back.vehicle == plant.vehicle
    assert back.soil == plant.soil
    assert (back.slip, back.resultant, back.half_car, back.v_eps, back.fine) == (
        plant.slip,
        plant.resultant,
        plant.half_car,
        plant.v_eps,
        plant.fine,
    )
    assert back.ground[:3] == plant.ground[:3]
    assert back.soil_map.edge == plant.soil_map.edge
    np.testing.assert_array_equal(back.ground.waves, plant.ground.waves)
    np.testing.assert_array_equal(back.soil_map.patches, plant.soil_map.patches)


def test_an_edit_starts_a_new_cache_for_the_kernels_that_it_reaches(tmp_path):
    for package in ("offroad_env", "estimators", "agents"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / package, tmp_path / package, ignore=ignored)
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from offroad_env.physics._jit import cache_folder\n"
        "for module in ('physics.numerics', 'physics.contact', 'physics.path_geometry'):\n"
        "    print(cache_folder('offroad_env.' + module))"
    )

    def after_an_edit_of(file: str) -> list[bool]:
        before = run_fresh(code).split()
        with (tmp_path / file).open("a") as source:
            source.write("# a change\n")
        return [a != b for a, b in zip(before, run_fresh(code).split(), strict=True)]

    assert after_an_edit_of("offroad_env/environment/observation.py") == [False, False, False]
    assert after_an_edit_of("offroad_env/physics/contact.py") == [False, True, False]
    assert after_an_edit_of("offroad_env/physics/numerics.py") == [True, True, False]
    assert after_an_edit_of("offroad_env/physics/path_geometry.py") == [False, False, True]
    assert after_an_edit_of("offroad_env/physics/_jit.py") == [True, True, True]
    assert after_an_edit_of("agents/commands/cli.py") == [False, False, False]
