"""Units of what slides: m and N in the place of rad and N m."""

_SLIDING = {
    "rad": "m",
    "rad/s": "m/s",
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "kg m^2": "kg",
    "rad/m": "1",
}


def sliding_unit(unit: str) -> str:
    """The unit that a number of this unit has where it slides."""
    return _SLIDING.get(unit, unit)
