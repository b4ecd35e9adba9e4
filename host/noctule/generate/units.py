"""Units as they stand in comments and as name suffixes: `m/s^2` and `_m_s2`."""

import re

# Parts of a unit that may be used; degrees, centimetres and milliseconds are absent on purpose.
ATOMS = ("m", "rad", "s", "us", "hz", "px", "sigma", "nat", "v")

_TOKEN = re.compile(r"(?:" + "|".join(ATOMS) + r")\d?|sqrt")


def suffix_tokens(unit):
    """Name tokens that a unit asks for, in order; an empty list for the dimensionless "-".

    Raises:
        ValueError: the unit holds something that is not one of ATOMS.

    >>> suffix_tokens("m/s^2"), suffix_tokens("rad/s/sqrt(Hz)"), suffix_tokens("-")
    (['m', 's2'], ['rad', 's', 'sqrt', 'hz'], [])
    """
    if unit == "-":
        return []
    flat = unit.lower().replace("sqrt(hz)", "sqrt_hz").replace("^", "").replace("/", "_").replace("*", "_").replace(" ", "_")
    tokens = flat.split("_")
    for token in tokens:
        if not _TOKEN.fullmatch(token):
            raise ValueError(f"unknown unit {unit!r}")
    return tokens


def name_tail(name):
    """Tokens at the end of a name that read as a unit.

    >>> name_tail("accel_max_m_s2"), name_tail("particles"), name_tail("r_m")
    (['m', 's2'], [], ['m'])
    """
    tail = []
    for token in reversed(name.split("_")[1:]):
        if not _TOKEN.fullmatch(token):
            break
        tail.insert(0, token)
    return tail


def name_matches_unit(name, unit):
    """Whether a name ends in its unit. A noise strength may say so before its unit: `gyro_sigma_rad_s`.

    >>> name_matches_unit("accel_max_m_s2", "m/s^2"), name_matches_unit("accel_max_m_s", "m/s^2")
    (True, False)
    >>> name_matches_unit("particles", "-"), name_matches_unit("gate_m", "-"), name_matches_unit("z_var_m2", "m^2")
    (True, False, True)
    """
    want = suffix_tokens(unit)
    tail = name_tail(name)
    while len(tail) > len(want) and tail[0] in ("sigma", "sqrt"):
        tail = tail[1:]
    return tail == want
