"""Makes code and documents from firmware/interface: parameters, streams and LCM message types.

`python -m noctule.generate --help` lists the products. Everything is written into the build folder except
docs/parameters.md and docs/messages.md, which are committed, and `*_gen.py` beside this package, which is not.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
INTERFACE = ROOT / "firmware" / "interface"


class InterfaceError(ValueError):
    """A file of firmware/interface breaks a rule; the text names file, entry and rule in one line."""


def write_if_changed(path, text):
    """Writes text to path unless it holds it already, so that nothing is rebuilt without need.

    Returns:
        bool, whether the file changed.
    """
    path = Path(path)
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return True
