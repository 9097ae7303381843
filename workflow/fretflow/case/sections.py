"""The tables of a case file: what each holds, in SI units, and what does not go together."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from fretflow.core import units as u

SIDES = ("upper", "lower")
Title = Annotated[str, Field(max_length=200)]  # two lines above a picture
MOST_CYCLES = 10**15  # still whole numbers as floats, and far beyond any test


class Section(BaseModel):
    """A table of the case file: unknown keys are errors, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _of_its_own_type(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse what would be turned into another type: truth is no number, and text neither of them."""
        field = cls.model_fields[info.field_name or ""]
        kinds = {field.annotation, *get_args(field.annotation)}
        if bool in kinds and not isinstance(value, bool):
            raise ValueError(f"must be true or false, got {value!r}")
        if bool not in kinds and any(isinstance(one, bool) for one in (value if isinstance(value, list) else [value])):
            raise ValueError("true and false are no value for it")
        plain = not kinds & {str, Any} and not any(isinstance(mark, BeforeValidator) for mark in field.metadata)
        texts = [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, str)]
        if texts and plain and kinds & {int, float}:
            raise ValueError(f"must be a number without quotes, got {texts[0]!r}")
        return value


class BodyShape(StrEnum):
    """Cross-section of a specimen's body."""

    SQUARE = "square"
    ROUND = "round"


class FaceShape(StrEnum):
    """Shape of the contact face: flat, crowned (sphere-like) or cylindrical (about the ridge's axis)."""

    FLAT = "flat"
    CROWNED = "crowned"
    CYLINDRICAL = "cylindrical"


class PeriodicMethod(StrEnum):
    """How the periodic solution is found."""

    QUASI_STATIC = "quasi-static"
    DLFT = "dlft"


class PreloadContact(StrEnum):
    """Tangential behaviour of the contact while the static load is applied."""

    FRICTIONLESS = "frictionless"
    FRICTIONAL = "frictional"


class WearScheme(StrEnum):
    """How the wear depth is advanced over a jump of cycles."""

    EXPLICIT = "explicit"
    IMPLICIT = "implicit"


class SlidingRegime(StrEnum):
    """How far the faces get over a period: no slip that shows, slip without a friction limit, or sliding at one."""

    STICK = "stick"
    PARTIAL_SLIP = "partial slip"
    GROSS_SLIP = "gross slip"


class Test(Section):
    """What is done to the joint."""

    excitation_frequency: u.Frequency = Field(100.0, description="frequency of the shaker force")
    excitation_amplitude: u.Force = Field(description="amplitude of the shaker force on the moving mass")
    normal_load: u.Force = Field(60.0, description="static normal load on the arm")
    cycles: int | None = Field(None, ge=0, le=MOST_CYCLES, description="length of the test in cycles")
    duration: u.Duration | None = Field(None, description="length of the test in time, instead of cycles")

    @model_validator(mode="after")
    def _one_length(self) -> Test:
        if (self.cycles is None) == (self.duration is None):
            raise ValueError("give exactly one of cycles and duration")
        if self.total_cycles > MOST_CYCLES:
            raise ValueError(f"duration makes {self.total_cycles:.3g} cycles; {MOST_CYCLES:.0e} are the most")
        return self

    @property
    def total_cycles(self) -> int:
        """Return the length of the test in cycles."""
        if self.cycles is not None:
            return self.cycles
        return round((self.duration or 0.0) * self.excitation_frequency)


class Rig(Section):
    """The two lumped masses: a driven block and the arm hinged to it that carries the upper specimen."""

    moving_mass: u.Mass = Field(10.0, description="mass of the driven block")
    arm_mass: u.Mass = Field(0.5, description="mass of the arm that carries the upper specimen")
    in_phase_frequency: u.Frequency = Field(40.0, description="in-phase sliding mode")
    out_of_phase_frequency: u.Frequency = Field(2500.0, description="out-of-phase sliding mode")
    damping_ratio: float = Field(0.01, ge=0.0, lt=1.0, description="damping ratio of each spring")
    hinge_damping_ratio: float | None = Field(None, ge=0.0, lt=1.0,
                                              description="damping ratio of the hinge, if another than that")

    @model_validator(mode="after")
    def _modes_apart(self) -> Rig:
        if self.out_of_phase_frequency < 10.0 * self.in_phase_frequency:
            raise ValueError("out_of_phase_frequency must be at least ten times in_phase_frequency, "
                             "so that each spring follows from one mode")
        if self.out_of_phase_frequency > 1e6 * self.in_phase_frequency:
            raise ValueError("out_of_phase_frequency must be at most a million times in_phase_frequency: beyond, "
                             "rounding is all that is left of the softer spring")
        return self


class Specimen(Section):
    """One body with a ridge whose flat, crowned or cylindrical face touches the other's."""

    youngs_modulus: u.Pressure = Field(193e9, description="Young's modulus")
    poissons_ratio: float = Field(0.29, gt=-1.0, lt=0.5, description="Poisson's ratio")
    density: u.Density = Field(8000.0, description="mass density")
    body: BodyShape = Field(BodyShape.SQUARE, description="cross-section of the body")
    body_width: u.Length = Field(6e-3, description="side of a square body, diameter of a round one")
    body_height: u.Length = Field(5e-3, description="height of the body behind the ridge")
    contact_width: u.Length = Field(1e-3, description="width of the ridge, hence side of the contact square")
    ridge_height: u.Length = Field(1e-3, description="height of the ridge")
    face: FaceShape = Field(FaceShape.FLAT, description="shape of the contact face")
    face_radius: u.Length | None = Field(None, description="radius of a crowned or cylindrical face")
    observation_distance: u.Length = Field(
        1e-3, description="distance of the observed point from the contact"
    )

    @model_validator(mode="after")
    def _geometry(self) -> Specimen:
        if self.contact_width >= self.body_width / (1.5 if self.body is BodyShape.ROUND else 1.0):
            raise ValueError("contact_width must be below body_width (two thirds of it on a round body)")
        if (self.face is FaceShape.FLAT) != (self.face_radius is None):
            raise ValueError("face_radius is given exactly when face is crowned or cylindrical")
        if self.face_radius is not None and self.face_radius <= self.contact_width:
            raise ValueError("face_radius must be larger than contact_width")
        if (
            self.face_radius is not None
            and self.contact_width**2 > 4.0 * self.face_radius * self.ridge_height
        ):
            raise ValueError("face_radius is so small that the face would be deeper than ridge_height")
        if self.observation_distance > self.ridge_height + self.body_height:
            raise ValueError("observation_distance lies outside the specimen")
        return self


class Specimens(Section):
    """The two specimens; keys given directly under [specimen] hold for both, [specimen.upper] overrides."""

    upper: Specimen = Field(default_factory=Specimen)
    lower: Specimen = Field(default_factory=Specimen)

    @model_validator(mode="before")
    @classmethod
    def _spread(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        shared = {k: v for k, v in value.items() if k not in SIDES}
        own = {side: value.get(side, {}) for side in SIDES}
        return {side: {**shared, **t} if isinstance(t, dict) else t for side, t in own.items()}

    @model_validator(mode="after")
    def _crossed(self) -> Specimens:
        if self.upper.contact_width != self.lower.contact_width:
            raise ValueError("contact_width must be the same on both specimens, so that their nodes match")
        return self


class Mesh(Section):
    """The finite-element meshes: made from the specimens' geometry, or the user's own."""

    contact_elements: int = Field(10, ge=2, le=200, description="elements per side of the contact square")
    degree: Literal[1, 2] = Field(1, description="degree of the hexahedra: 1 (8 nodes) or 2 (27 nodes)")
    growth: float = Field(1.35, ge=1.0, le=3.0, description="ratio of neighbouring element sizes")
    upper: Path | None = Field(None, description="your own mesh of the upper specimen")
    lower: Path | None = Field(None, description="your own mesh of the lower specimen")
    unit: u.Length = Field(1.0, description='that your own meshes count in, such as "1 mm"')

    @field_validator("upper", "lower")
    @classmethod
    def _names_a_file(cls, value: Path | None) -> Path | None:
        if value is not None and "\0" in str(value):
            raise ValueError("no file has a null character in its name")
        return value

    @model_validator(mode="after")
    def _both(self) -> Mesh:
        if (self.upper is None) != (self.lower is None):
            raise ValueError("give both of upper and lower, or neither")
        return self


class Reduction(Section):
    """Craig-Bampton reduction and damping of the specimens."""

    fixed_interface_modes: int = Field(10, ge=1, le=200, description="fixed-interface modes of each specimen")
    checked_frequencies: int = Field(10, ge=1, le=50, description="frequencies compared with the full model")
    rayleigh_mass: u.RayleighMass = Field(0.0, description="Rayleigh damping proportional to mass")
    rayleigh_stiffness: u.RayleighStiffness = Field(
        1e-8, description="Rayleigh damping proportional to stiffness")


class ContactSection(Section):
    """The contact law."""

    friction_coefficient: float = Field(0.88, gt=0.0, le=5.0, description="Coulomb friction coefficient")
    preload: PreloadContact = Field(
        PreloadContact.FRICTIONLESS, description="friction while the load is applied")


class Solver(Section):
    """The periodic solver."""

    method: PeriodicMethod = Field(
        PeriodicMethod.QUASI_STATIC, description="how the periodic solution is found")
    harmonics: int | None = Field(None, ge=1, le=500,
                                  description="harmonics kept; 40 of the rig (quasi-static), 3 (dlft)")
    samples: int | None = Field(None, ge=8, le=65536,
                                description="time samples per period; 256 (quasi-static), 128 (dlft)")
    penalty: u.Stiffness | None = Field(
        None, description="DLFT penalty; by default the spectral radius of the stiffness")
    tolerance: float = Field(1e-9, gt=0.0, le=1e-3, description="residual force relative to the load")
    max_iterations: int = Field(60, ge=1, le=10000, description="Newton iterations before giving up")
    estimate_error: bool = Field(True, description="state the solution's error from a second one")

    @model_validator(mode="after")
    def _enough_samples(self) -> Solver:
        if self.resolved_samples < 4 * self.resolved_harmonics:
            raise ValueError(
                f"samples = {self.resolved_samples} is too few for {self.resolved_harmonics} harmonics; "
                f"at least {4 * self.resolved_harmonics} are needed")
        if self.penalty is not None and self.method is not PeriodicMethod.DLFT:
            raise ValueError('penalty is only used by method = "dlft"')
        return self

    @property
    def resolved_harmonics(self) -> int:
        """Return the harmonics, or the method's default."""
        return self.harmonics or (3 if self.method is PeriodicMethod.DLFT else 40)

    @property
    def resolved_samples(self) -> int:
        """Return the samples, or the method's default."""
        return self.samples or (128 if self.method is PeriodicMethod.DLFT else 256)


class Wear(Section):
    """Archard wear and the cycle jumps."""

    coefficient: u.WearCoefficient = Field(
        1.1e-14, description="Archard wear coefficient: volume per load and sliding")
    scheme: WearScheme = Field(WearScheme.IMPLICIT, description="how a jump of cycles is made")
    tolerance: float = Field(
        1e-2, gt=0.0, lt=1.0, description="error of an implicit jump, relative to the largest depth")
    max_depth_per_jump: u.Length | None = Field(
        None, description="largest wear of a node in one jump; by default what reshapes the pressure (explicit)")
    upper_share: float = Field(0.5, ge=0.0, le=1.0, description="share of the depth worn off the upper face")
    vanishing_rate: float = Field(
        1e-6, ge=0.0, lt=1.0, description="stop when the volume rate falls below this share of the first one"
    )


class FrequencyResponse(Section):
    """Frequencies of the forced response about the first mode."""

    start: u.Frequency = Field(20.0, description="lowest frequency")
    stop: u.Frequency = Field(400.0, description="highest frequency")
    points: int = Field(120, ge=2, le=10000, description="number of frequencies")

    @model_validator(mode="after")
    def _ordered(self) -> FrequencyResponse:
        if self.stop <= self.start:
            raise ValueError("stop must be above start")
        return self


class Output(Section):
    """What is kept of a run."""

    loop_cycles: tuple[int, ...] = Field(
        (), description="cycle counts whose hysteresis loops are kept; ends included"
    )
    wear_map_cycles: tuple[int, ...] = Field(
        (), description="cycle counts whose wear maps are kept; the end included"
    )
    figures: tuple[str, ...] | None = Field(
        None, description="pictures to draw, such as loops or wear_depth; all where not set")
    figure_formats: tuple[Literal["png", "svg", "pdf"], ...] = Field(
        ("png",), min_length=1, description="of each picture; animations are gif")
    frequency_response: FrequencyResponse = Field(default_factory=FrequencyResponse)

    @field_validator("loop_cycles", "wear_map_cycles")
    @classmethod
    def _ascending(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if any(c < 0 for c in value) or list(value) != sorted(set(value)):
            raise ValueError("cycle counts must be non-negative and ascending")
        return value


class Measured(Section):
    """What was measured on the real joint, to compare with and to calibrate on; no prediction reads it."""

    sliding_distance: u.Length | None = Field(
        None, description="peak-to-peak relative displacement, mean of the test")
    sliding_distance_sd: u.Length | None = Field(None, description="its standard deviation")
    worn_volume: u.Volume | None = Field(None, description="volume worn off both faces by the end of the test")
    worn_volume_sd: u.Volume | None = Field(None, description="its standard deviation")
    regime: SlidingRegime | None = Field(None, description="sliding regime of the test")
    in_phase_frequency: u.Frequency | None = Field(None, description="in-phase sliding mode of the bare rig")
    out_of_phase_frequency: u.Frequency | None = Field(
        None, description="out-of-phase sliding mode of the bare rig")

    @model_validator(mode="after")
    def _sd_of_something(self) -> Measured:
        for key in ("sliding_distance", "worn_volume"):
            if getattr(self, key) is None and getattr(self, f"{key}_sd") is not None:
                raise ValueError(f"{key}_sd is given without {key}")
        return self
