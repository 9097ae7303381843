"""Units at the boundary: text with a unit in, SI floats inside, text with a unit out."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from functools import cache
from tokenize import TokenError
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    import pint


@cache
def registry() -> pint.UnitRegistry[Any]:
    """Return the one unit registry of the process."""
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=False)


# Units that engineers write and read, with their size in SI, largest first; these do not need pint.
_READABLE = {
    "m": (("m", 1.0), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9)),
    "Pa": (("TPa", 1e12), ("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3), ("Pa", 1.0)),
    "N/m": (("N/um", 1e6), ("N/mm", 1e3), ("N/m", 1.0)),
    "N": (("MN", 1e6), ("kN", 1e3), ("N", 1.0), ("mN", 1e-3)),
    "Hz": (("kHz", 1e3), ("Hz", 1.0)),
    "kg": (("kg", 1.0), ("g", 1e-3)),
    "s": (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)),
    "m^3": (("mm^3", 1e-9), ("um^3", 1e-18)),
    "J": (("J", 1.0), ("mJ", 1e-3), ("uJ", 1e-6)),
    "m/s": (("m/s", 1.0), ("mm/s", 1e-3), ("um/s", 1e-6)),
    "m/N": (("mm/N", 1e-3), ("um/N", 1e-6), ("nm/N", 1e-9)),
    "W/m^2": (("W/mm^2", 1e6), ("kW/m^2", 1e3), ("W/m^2", 1.0)),
    "N/m^3": (("MN/mm^3", 1e15), ("kN/mm^3", 1e12), ("N/mm^3", 1e9), ("N/m^3", 1.0)),
}

# Of any quantity in SI; squares and products of such numbers still fit into a float.
BEYOND = 1e24

# Of a unit as text: what is longer, or holds a number that is no power of a unit, would be computed without end.
LONGEST = 60
_POWER = re.compile(r"(?:\^|\*\*)\s*\(?\s*[-+]?\d(?:\.\d+)?(?:/\d)?\s*\)?(?!\s*(?:\^|\*\*)|[\d.])")
_STRANGE = re.compile(r"\^|\*\*|(?<![\w.])(?!1(?![\w.]))[\d.]")

_NUMBER = re.compile(r"\s*([+-]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


def parse_quantity(value: object, unit: str) -> float:
    """Convert a text such as ``"60 N"`` to a float in `unit`.

    Parameters
    ----------
    value : object
        Text with one number and its unit.
    unit : str
        The SI unit that the result is expressed in.

    Raises
    ------
    ValueError
        If the unit is missing, unknown or of another dimension, or the number is not finite or beyond reason.
        Angles count as a dimension: an angular frequency is no frequency.
    """
    example = f'write it as text with its unit, for example "1 {unit}"'
    match = _NUMBER.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ValueError(f"{value!r} is not text with a number and its unit; {example}")
    if not match[2]:
        raise ValueError(f"{value!r} has no unit; {example}")
    number = float(match[1]) * _factor(match[2], unit, f"{value!r}", example)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not a finite number")
    if number and not 1.0 / BEYOND <= abs(number) <= BEYOND:
        raise ValueError(f"{value!r} is beyond what any joint has; check the number and its unit")
    return number


def _factor(given: str, unit: str, value: str, example: str) -> float:
    if given == unit:
        return 1.0
    if given in (sizes := dict(_READABLE.get(unit, ()))):
        return sizes[given]
    if len(given) > LONGEST or _STRANGE.search(_POWER.sub("", given)):
        raise ValueError(f"{value} is not a number with a known unit; {example}")
    import pint

    try:
        source = registry().Quantity(1.0, registry().parse_units(given))
        target = registry().Quantity(1.0, unit)
    except (pint.PintError, TokenError, ValueError, TypeError, AttributeError, SyntaxError, KeyError,
            ArithmeticError, AssertionError) as error:
        raise ValueError(f"{value} is not a number with a known unit; {example}") from error
    if source.to_root_units().units != target.to_root_units().units:
        raise ValueError(f"{value} has the wrong dimension, expected a unit like {unit}; {example}")
    return float(source.to(unit).magnitude)


def format_quantity(value: float, unit: str, digits: int = 6) -> str:
    """Return `value`, in the SI unit `unit`, as typed in the unit that engineers read, like ``"14.2 um"``."""
    name, size = readable_unit(value, unit)
    return f"{value / size:.{digits}g} {name}".rstrip()


def exact_quantity(value: float, unit: str) -> str:
    """Return `value`, in the SI unit `unit`, with the fewest figures that read back to the last bit."""
    units = (readable_unit(value, unit), *_READABLE.get(unit, ()), (unit, 1.0))
    texts = [f"{text} {name}" for name, size in units for number in (float(value / size),)
             for text in (f"{number:.15g}", repr(number).removesuffix(".0"))]
    exact = (text for text in texts if parse_quantity(text, unit) == value)
    return min(exact, key=lambda text: text.index(" ") - (not text.startswith("0.") and "." in text))  # a point is none


def pretty_quantity(value: float, unit: str, digits: int = 6) -> str:
    """Return `value`, in the SI unit `unit`, as it is printed for people, like ``"14.2 µm"``."""
    name, size = readable_unit(value, unit)
    number, printed = pretty_number(value / size, digits), pretty_unit(name)
    return f"{number.replace(',', '')} {printed}" if printed else number  # with a unit it reads back


def per_cent(share: float, digits: int = 0) -> str:
    """Return a share of 1 in per cent, as people read it."""
    return f"{100.0 * share:.{digits}f} %"


def pretty_number(value: float, digits: int = 6) -> str:
    """Return a number with so many figures as it is printed for people: ``"0.35"``, ``"100,000"``."""
    rounded = float(f"{value:.{digits}g}")
    if not min(1e3, 10.0**digits) <= abs(rounded) < 1e15:
        return f"{value:.{digits}g}"
    text = f"{rounded:,.{max(0, digits - 1 - int(math.log10(abs(rounded))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def pretty_unit(unit: str) -> str:
    """Return `unit` as it is printed: ``um^2`` becomes ``µm²``, that of a ratio nothing."""
    if unit == "1":
        return ""
    for plain, printed in (("um", "µm"), ("us", "µs"), ("uJ", "µJ"), ("^2", "²"), ("^3", "³"), ("*", "·")):
        unit = unit.replace(plain, printed)
    return unit


def readable_unit(value: float, unit: str) -> tuple[str, float]:
    """Return the unit that engineers read `value` in, which is in the SI unit `unit`, and its size in SI."""
    choices = _READABLE.get(unit, ((unit, 1.0),))
    if value == 0.0:
        return unit, 1.0
    return next((c for c in choices if abs(value) >= c[1] * 0.999999), choices[-1])


class Unit:
    """Marks an annotated float field with the SI unit that it is kept in."""

    def __init__(self, unit: str) -> None:
        self.unit = unit


def _parser(unit: str) -> BeforeValidator:
    def parse(value: object) -> float:
        try:
            return parse_quantity(value, unit)
        except ValueError as error:
            raise PydanticCustomError("unit", "{reason}", {"reason": str(error)}) from error

    return BeforeValidator(parse)


def _positive(value: float) -> float:
    if not value > 0.0:
        raise PydanticCustomError("positive", "Input should be positive")
    return value


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise PydanticCustomError("not_negative", "Input should not be negative")
    return value


Frequency = Annotated[float, Unit("Hz"), _parser("Hz"), AfterValidator(_positive)]
Force = Annotated[float, Unit("N"), _parser("N"), AfterValidator(_positive)]
Mass = Annotated[float, Unit("kg"), _parser("kg"), AfterValidator(_positive)]
Length = Annotated[float, Unit("m"), _parser("m"), AfterValidator(_positive)]
Volume = Annotated[float, Unit("m^3"), _parser("m^3"), AfterValidator(_positive)]
Duration = Annotated[float, Unit("s"), _parser("s"), AfterValidator(_positive)]
Pressure = Annotated[float, Unit("Pa"), _parser("Pa"), AfterValidator(_positive)]
Density = Annotated[float, Unit("kg/m^3"), _parser("kg/m^3"), AfterValidator(_positive)]
Stiffness = Annotated[float, Unit("N/m"), _parser("N/m"), AfterValidator(_positive)]
WearCoefficient = Annotated[float, Unit("m^2/N"), _parser("m^2/N"), AfterValidator(_not_negative)]
Energy = Annotated[float, Unit("J"), _parser("J"), AfterValidator(_positive)]
Velocity = Annotated[float, Unit("m/s"), _parser("m/s"), AfterValidator(_positive)]
SignedLength = Annotated[float, Unit("m"), _parser("m")]
SignedForce = Annotated[float, Unit("N"), _parser("N")]
SignedStiffness = Annotated[float, Unit("N/m"), _parser("N/m")]
SignedMass = Annotated[float, Unit("kg"), _parser("kg")]
SignedTime = Annotated[float, Unit("s"), _parser("s")]
SignedDamping = Annotated[float, Unit("N*s/m"), _parser("N*s/m")]
SignedCompliance = Annotated[float, Unit("m/N"), _parser("m/N")]
SignedCurvature = Annotated[float, Unit("1/m"), _parser("1/m")]
CubicStiffness = Annotated[float, Unit("N/m^3"), _parser("N/m^3")]
PowerDensity = Annotated[float, Unit("W/m^2"), _parser("W/m^2"), AfterValidator(_not_negative)]
RayleighMass = Annotated[float, Unit("1/s"), _parser("1/s"), AfterValidator(_not_negative)]
RayleighStiffness = Annotated[float, Unit("s"), _parser("s"), AfterValidator(_not_negative)]


def smallest(marks: Iterable[object]) -> float | None:
    """Return zero if the marks of an annotated field refuse negative values, else None."""
    refuses = any(isinstance(mark, AfterValidator) and mark.func in (_positive, _not_negative) for mark in marks)
    return 0.0 if refuses else None
