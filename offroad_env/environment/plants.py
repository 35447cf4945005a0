"""Which plant an environment drives, and which one its estimator assumes."""

from __future__ import annotations

from dataclasses import dataclass

from offroad_env.environment.arguments import require_choice
from offroad_env.environment.episode_records import SOIL_WAVES, PlantSizes
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.axle import contact_shape
from offroad_env.physics.records import FourWheel, Ground, Soil, SoilField, SoilMap, Structure, Tyre, Vehicle
from offroad_env.simulation.simulator import MODELS, PAPER_SLIP, VEHICLE_MODELS, Plant, make_plant
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.natural_soil import SoilSpread, natural_soil
from offroad_env.world.soils import with_exponent
from offroad_env.world.terrain import flat

__all__ = ["FOUR_WHEEL", "PlantChoice"]

#: The vehicle model with roll.
FOUR_WHEEL = "four_wheel"


@dataclass(frozen=True, kw_only=True)
class PlantChoice:
    """The arguments of an environment that decide about its plants.

    Raises
    ------
    InvalidParameter
        For a choice that there is not, or choices that exclude each other.
    """

    soil_name: str
    vehicle: Vehicle  #: nominal one
    four_wheel: FourWheel | None = None  #: what is stated of its four wheels; None: the rules hold
    model: str = "full"
    vehicle_model: str = "half_car"
    structure: str | Structure | None = None
    tyre: str | Tyre | None = None
    natural_soil: bool | SoilSpread = False

    def __post_init__(self) -> None:
        require_choice("model", self.model, MODELS)
        require_choice("vehicle_model", self.vehicle_model, (*VEHICLE_MODELS, FOUR_WHEEL))

    @property
    def is_natural(self) -> bool:
        """Whether the soil varies as a random field."""
        return self.natural_soil is not False

    def soil_field(self, soil: Soil, seed: int) -> SoilField:
        """The random field of an episode around its soil."""
        spread = self.natural_soil if isinstance(self.natural_soil, SoilSpread) else None
        return natural_soil(soil, seed, spread=spread, waves=SOIL_WAVES)

    def require_natural(self, soil: Soil, exponents: tuple[float, float]) -> None:
        """Refuse a soil around which natural soil cannot vary, with one of these exponents [-].

        Raises
        ------
        InvalidParameter
        """
        if not self.is_natural:
            return
        if soil.rigid > 0.5:
            raise InvalidParameter(
                "natural soil needs a deformable soil, got hard ground: take natural_soil=False, "
                "structure=None, tyre=None"
            )
        for n in exponents:
            self.soil_field(with_exponent(soil, n), 0)

    def truth(
        self,
        vehicle: Vehicle,
        soil: Soil,
        ground: Ground,
        soils: SoilMap | None = None,
        field: SoilField | None = None,
    ) -> Plant:
        """The plant that is driven; roll inertia and stiffness are those of the nominal vehicle."""
        four = None
        if self.vehicle_model == FOUR_WHEEL:
            four = make_four_wheel(self.vehicle) if self.four_wheel is None else self.four_wheel
        return make_plant(
            vehicle,
            soil,
            ground,
            slip=PAPER_SLIP.get(self.soil_name, 0.0),
            soil_map=soils,
            model=self.model,
            vehicle_model=self.vehicle_model,
            four_wheel=four,
            structure=self.structure,
            tyre=self.tyre,
            soil_field=field,
        )

    def belief(self, vehicle: Vehicle, soil: Soil, ground: Ground, *, wheels: bool = False) -> Plant:
        """The plant that estimators assume: a half-car where the truth has more.

        With rigid rims; where ``wheels`` is true, with the structure and the tyre of the truth.
        """
        slip = PAPER_SLIP.get(self.soil_name, 0.0)
        kind = "half_car" if self.vehicle_model == FOUR_WHEEL else self.vehicle_model
        laws = (self.structure, self.tyre) if wheels else (None, None)
        return make_plant(
            vehicle,
            soil,
            ground,
            slip=slip,
            model=self.model,
            vehicle_model=kind,
            structure=laws[0],
            tyre=laws[1],
        )

    def sizes(self, soil: Soil) -> PlantSizes:
        """Lengths of the arrays of an episode."""
        plant = self.truth(self.vehicle, soil, flat())
        return PlantSizes(*contact_shape(plant.structure, plant.four_wheel), *at.sizes(plant.four_wheel))
