"""Pictures for objects with texture: coloured shapes, drawn from the name of the material alone.

The same name gives the same picture on every machine; two names give two pictures that share nothing but their style.
"""

from __future__ import annotations

import colorsys
import zlib

import numpy as np

SIZE_PX = 256


def picture(name: str, rgb) -> np.ndarray:
    """(256, 256, 3) uint8, red green blue: a ground of about the given colour (0 to 1) under shapes of other colours.

    >>> (picture("a", (0.8, 0.1, 0.1)) == picture("a", (0.8, 0.1, 0.1))).all(), (picture("a", (0.8, 0.1, 0.1)) == picture("b", (0.8, 0.1, 0.1))).all()
    (np.True_, np.False_)
    """
    import cv2

    rng = np.random.default_rng(zlib.crc32(name.encode()))
    image = np.empty((SIZE_PX, SIZE_PX, 3), np.uint8)
    image[:] = np.round(255 * np.array(rgb[:3]))
    base = colorsys.rgb_to_hsv(*rgb[:3])[0]
    for _ in range(46):
        # Most shapes keep near the ground's hue in another brightness, some are of any hue: a label, not confetti.
        hue = (base + rng.normal(0.0, 0.05)) % 1.0 if rng.random() < 0.6 else rng.random()
        colour = [int(255 * c) for c in colorsys.hsv_to_rgb(hue, rng.uniform(0.65, 1.0), rng.choice([0.35, 0.6, 0.95]))]
        x, y = (int(v) for v in rng.integers(0, SIZE_PX, 2))
        a, b = (int(v) for v in rng.integers(8, 42, 2))
        kind = rng.integers(4)
        if kind == 0:
            cv2.ellipse(image, (x, y), (a, b), float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
        elif kind == 1:
            corners = cv2.boxPoints(((x, y), (2.0 * a, 2.0 * b), float(rng.uniform(0, 90))))
            cv2.fillPoly(image, [np.round(corners).astype(np.int32)], colour, cv2.LINE_AA)
        elif kind == 2:
            corners = np.array([x, y]) + rng.integers(-45, 45, (3, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], colour, cv2.LINE_AA)
        else:
            text = "".join(rng.choice(list("ABEHKMNRSXZ2345789"), 2))
            cv2.putText(image, text, (x - 20, y + 12), cv2.FONT_HERSHEY_SIMPLEX, float(rng.uniform(0.8, 1.8)), colour, int(rng.integers(2, 6)), cv2.LINE_AA)
    return image


def png(name: str, rgb) -> bytes:
    """picture() as a PNG file."""
    import cv2

    done, data = cv2.imencode(".png", picture(name, rgb)[:, :, ::-1])
    assert done
    return data.tobytes()
