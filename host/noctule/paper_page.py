"""The page of `noctule paper`: every figure with its numbers beside the published ones, and what differs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from noctule.paper import Figure, Row

HEAD = """# The paper, redrawn

Made by `noctule paper`; every number and picture on this page is of one run of it. G. Pepe, M. Satler, P. Tripicchio,
"Autonomous exploration of indoor environments with a micro-aerial vehicle": each of its test set-ups with the values that it states (`--preset paper`), each figure
drawn again, each published number beside ours. The column `default` is the same set-up with Noctule's own values.

The publication's data (V-REP scenes, sensor noise, the shape of mazes and building) is not available: buildings are of the same size and kind, sensors are those of
`docs/design.md`. So a number here says what the published method does in our set-up; it is no measurement of the authors' program.
"""

TAIL = """## What the preset leaves as ours

Rejecting of bad samples, de-skewing of sweeps, the estimate of velocity and inertial bias, the reference and the guard, take-off, the way between floors, return and landing: the
publication says nothing of these, and nothing flies without them. Where its formulas are wrong or silent, ours are in docs/maths/ with the reason: the distance of a point to a line, the bearing to a wall seen
from behind, the weight of a particle, eq. 5 for N levels.
"""


def table(rows: list[Row]) -> str:
    """A Markdown table."""
    lines = ["| | published | paper preset | default |", "|---|---|---|---|"]
    return "\n".join(lines + [f"| {r.what} | {r.published} | {r.ours} | {r.default} |" for r in rows])


def page(figures: list[Figure], run: str, pictures: str) -> str:
    """The whole page. run: how it was made, one line. pictures: folder of the pictures, relative to the page."""
    out = [HEAD, run + "\n"]
    for figure in figures:
        out.append(f"## Figure {figure.number}: {figure.title}\n\n{figure.setup}\n")
        out.append(table(figure.rows) + "\n")
        out += [f"![Figure {figure.number}, redrawn: {figure.title}]({pictures}/{name})\n" for name in figure.pictures]
        out.append(figure.remarks + "\n")
    return "\n".join([*out, TAIL])


def make(out: Path, quick: bool, say: Callable[[str], None] = print) -> Path:
    """Runs every set-up and writes OUT/paper.md with OUT/pictures/paper/*.png; the page's path. Flights go to OUT-independent scratch.

    Raises:
        LibraryMissing: the firmware's shared library was not built.
    """
    import tempfile

    from noctule import paper

    begin = time.monotonic()
    seeds = 2 if quick else 10
    figures: list[Figure] = []

    def told(made: list[Figure]) -> None:
        figures.extend(made)
        for figure in made:
            for row in figure.rows:
                say(f"figure {figure.number}: {row.what}: published {row.published}; paper preset {row.ours}; default {row.default}")

    with tempfile.TemporaryDirectory(prefix="noctule-paper-") as name:
        folder = Path(name)
        told(paper.poses(seeds))
        told(paper.altitude(2 * seeds))
        told([paper.maze(quick)])
        told(paper.two_floors(folder, quick))
        told([paper.objects(folder, quick)])
    figures.sort(key=lambda f: int(f.number))
    pictures = out / "pictures" / "paper"
    pictures.mkdir(parents=True, exist_ok=True)
    for figure in figures:
        for file, content in figure.pictures.items():
            (pictures / file).write_bytes(content)
    run = f"Run: `noctule paper{' --quick' if quick else ''}`, seeds from 1 on."
    path = out / "paper.md"
    path.write_text(page(figures, run, "pictures/paper"), encoding="utf-8")
    say(f"{len(figures)} figures in {time.monotonic() - begin:.0f} s")
    return path
