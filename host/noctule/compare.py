"""Are two runs equal? Everything that a seed decides must be; what the machine decides is left out."""

from __future__ import annotations

import math

# Wall time, memory of the process, dates and paths differ between equal runs (docs/design.md, "Lockstep").
EXCLUDED = ("wall_time_s", "realtime_factor", "step_ms", "memory.rss_kib", "date", "run")


def _flat(value, name=""):
    if name in EXCLUDED:
        return
    if isinstance(value, dict):
        for key in value:
            yield from _flat(value[key], f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        yield f"{name} (length)", len(value)
        for n, item in enumerate(value):
            yield from _flat(item, f"{name}[{n}]")
    else:
        yield name, value


def differences(a: dict, b: dict) -> list[str]:
    """What two reports differ in, one line a field; empty if they are equal but for the excluded fields.

    >>> differences({"seed": 1, "wall_time_s": 3.0}, {"seed": 1, "wall_time_s": 9.0})
    []
    >>> differences({"seed": 1}, {"seed": 2})
    ['seed: 1 and 2']
    """
    left, right = dict(_flat(a)), dict(_flat(b))
    lines = []
    for name in list(left) + [n for n in right if n not in left]:
        if name not in left or name not in right:
            lines.append(f"{name}: only in the {'second' if name not in left else 'first'}")
            continue
        x, y = left[name], right[name]
        both_nan = isinstance(x, float) and isinstance(y, float) and math.isnan(x) and math.isnan(y)
        if x != y and not both_nan:
            lines.append(f"{name}: {x} and {y}")
    return lines
