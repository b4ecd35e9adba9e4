"""python -m noctule.generate {cpp,python,docs,check}: makes what firmware/interface says, see --help."""

import argparse
import sys
from pathlib import Path

from noctule.generate import ROOT, InterfaceError, lcm, metadata, parameters, streams, write_if_changed

HOST = Path(__file__).resolve().parents[1]


def products():
    """Committed documents: path -> text."""
    rows, messages = parameters.load(), lcm.load()
    return {
        ROOT / "docs" / "parameters.md": parameters.docs(rows),
        ROOT / "docs" / "messages.md": streams.docs(streams.load(messages=messages), messages),
    }


def main(argv=None):
    """Exit code: 0 done, 1 a committed document is stale, 2 bad input."""
    parser = argparse.ArgumentParser(prog="python -m noctule.generate", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (("cpp", "params.gen.hpp, streams.gen.hpp, lcmtypes/ and lcm_checks.gen.cpp, for the C++ build"),
                       ("python", "noctule_lcm under --out, noctule/params_gen.py and noctule/streams_gen.py")):
        commands.add_parser(name, help=text).add_argument("--out", required=True, type=Path, metavar="DIR")
    commands.add_parser("docs", help="docs/parameters.md and docs/messages.md (committed)")
    commands.add_parser("check", help="say which committed document is stale; exit 1 then")
    arguments = parser.parse_args(argv)
    try:
        if arguments.command == "cpp":
            write_if_changed(arguments.out / "params.gen.hpp", parameters.cpp(parameters.load()))
            write_if_changed(arguments.out / "metadata.gen.hpp", metadata.cpp(parameters.load()))
            write_if_changed(arguments.out / "streams.gen.hpp", streams.cpp(streams.load(messages=lcm.load())))
            lcm.generate_cpp(arguments.out)
        elif arguments.command == "python":
            lcm.generate_python(arguments.out)
            write_if_changed(HOST / "params_gen.py", parameters.python(parameters.load()))
            write_if_changed(HOST / "streams_gen.py", streams.python(streams.load(messages=lcm.load())))
        elif arguments.command == "docs":
            for path, text in products().items():
                if write_if_changed(path, text):
                    print(f"wrote {path.relative_to(ROOT)}")
        else:
            stale = [p for p, text in products().items() if not p.exists() or p.read_text(encoding="utf-8") != text]
            for path in stale:
                print(f"{path.relative_to(ROOT)} is stale: run .venv/bin/python -m noctule.generate docs", file=sys.stderr)
            return 1 if stale else 0
    except InterfaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
