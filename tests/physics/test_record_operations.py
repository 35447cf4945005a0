"""Records change single fields and cross as arrays without anybody listing their fields."""

from __future__ import annotations

import math
from typing import NamedTuple, get_type_hints

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from offroad_env.physics import records
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import Plant, with_exponent, with_pressure
from offroad_env.physics.imu import ImuMount
from offroad_env.physics.packing import PackedPlant
from offroad_env.physics.record_operations import (
    array_count,
    number_count,
    numbers_of,
    record_from,
    replace,
)
from offroad_env.physics.records import FloatArray, Soil, Wheel
from offroad_env.world.soils import SOILS

FLAT_RECORDS = [
    cls
    for cls in vars(records).values()
    if isinstance(cls, type) and hasattr(cls, "_fields") and array_count(cls) == 0
]


class Inner(NamedTuple):
    a: float
    rows: FloatArray


class Outer(NamedTuple):
    first: Inner
    flag: bool
    second: Inner
    b: float
    effects: FloatArray | None


@inline_kernel
def wider(wheel: Wheel, share: float) -> Wheel:
    return replace(wheel, b=share * wheel.b)


@merged_kernel
def wider_and_larger(wheel: Wheel, share: float) -> Wheel:
    return replace(wider(wheel, share), r=share * wheel.r)


@kernel
def grown(wheel: Wheel, share: float) -> Wheel:
    return wider_and_larger(wheel, share)


@kernel
def swapped(wheel: Wheel) -> Wheel:
    return replace(wheel, b=wheel.r, r=wheel.b)


@kernel
def turned_level(mount: ImuMount, lever: FloatArray) -> ImuMount:
    return replace(mount, body_axes=0, lever=lever)


@kernel
def outer_from(numbers: FloatArray, rows: FloatArray, more: FloatArray) -> Outer:
    return record_from(Outer, numbers, (rows, more, None))


def test_replace_changes_the_named_fields_and_no_others():
    wheel = Wheel(r=0.3, b=0.2)
    assert grown(wheel, 2.0) == Wheel(r=0.6, b=0.4)
    assert swapped(wheel) == Wheel(r=0.2, b=0.3)
    assert replace(wheel, b=0.1) == Wheel(r=0.3, b=0.1)
    assert type(swapped(wheel)) is Wheel


def test_the_order_of_the_names_does_not_matter():
    @kernel
    def named_backwards(soil: Soil) -> Soil:
        return replace(soil, mu=0.5, k_c=1.0)

    soil = SOILS["clay"]
    assert named_backwards(soil) == soil._replace(k_c=1.0, mu=0.5)


def test_replace_takes_arrays_and_keeps_the_type_of_a_number():
    mount = ImuMount(np.zeros(3), np.eye(3), 1.0, 9.81)
    changed = turned_level(mount, np.ones(3))
    assert changed.body_axes == 0.0
    np.testing.assert_array_equal(changed.lever, np.ones(3))
    np.testing.assert_array_equal(changed.rotation, np.eye(3))
    if not numba.config.DISABLE_JIT:
        assert isinstance(changed.body_axes, float)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python raises a ValueError instead")
def test_an_unknown_field_is_refused_by_its_name():
    @kernel
    def misspelt(wheel: Wheel) -> Wheel:
        return replace(wheel, radius=0.5)

    with pytest.raises(TypingError, match="Wheel has no field radius"):
        misspelt(Wheel(0.3, 0.2))


def test_a_soil_with_another_pressure_keeps_the_rest():
    soil = SOILS["clay"]
    assert with_pressure(soil, 0.8, 2.0) == soil._replace(n=0.8, k_c=2.0 * soil.k_c, k_phi=2.0 * soil.k_phi)
    assert with_exponent(soil, 0.8) == soil._replace(n=0.8)


@pytest.mark.parametrize("cls", FLAT_RECORDS)
def test_every_flat_record_returns_from_its_numbers(cls):
    @kernel
    def assembled(numbers: FloatArray) -> cls:
        return record_from(cls, numbers, ())

    kinds = get_type_hints(cls)
    record = cls(*(kinds[name] is bool or math.sqrt(2.0 + i) for i, name in enumerate(cls._fields)))
    numbers = np.array(numbers_of(record))
    assert number_count(cls) == len(numbers) == len(cls._fields)
    assert assembled(numbers) == record
    # Every second number of a longer row: an array that is not contiguous.
    assert assembled(np.repeat(numbers, 2)[::2]) == record


@pytest.mark.parametrize("flag", [True, False])
def test_a_nested_record_returns_from_its_numbers_and_arrays(flag):
    rows, more = np.arange(4.0), np.arange(6.0)
    record = Outer(Inner(1.5, rows), flag, Inner(2.5, more), 3.5, None)
    assert numbers_of(record) == [1.5, float(flag), 2.5, 3.5]
    assert (number_count(Outer), array_count(Outer)) == (4, 3)
    back = outer_from(np.array(numbers_of(record)), rows, more)
    assert (back.first.a, back.flag, back.second.a, back.b, back.effects) == (1.5, flag, 2.5, 3.5, None)
    np.testing.assert_array_equal(back.first.rows, rows)
    np.testing.assert_array_equal(back.second.rows, more)


def test_a_plant_has_its_arrays_in_the_order_of_the_packed_one():
    packed_apart = set(PackedPlant._fields) - {"numbers"}
    assert array_count(Plant) == len(packed_apart)
