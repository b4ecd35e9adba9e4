#!/usr/bin/env bash
# Makes requirements.lock anew: the newest versions that pyproject.toml allows, in an environment of their own.
set -euo pipefail
cd "$(dirname "$0")/.."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
/usr/bin/python3 -m venv "$scratch/venv"
listed() {
    "$scratch/venv/bin/python" -c '
import sys, tomllib
project = tomllib.load(open("pyproject.toml", "rb"))
extra = project["project"]["optional-dependencies"][sys.argv[1]]
print(*(project["build-system"]["requires"] + project["project"]["dependencies"] + extra if sys.argv[1] == "test" else extra), sep="\n")' "$1"
}
mapfile -t wanted < <(listed test)
mapfile -t alone < <(listed station)
"$scratch/venv/bin/pip" install --quiet --disable-pip-version-check --upgrade "${wanted[@]}" wheel
"$scratch/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps "${alone[@]}"
{
    echo '# Exact versions of everything in .venv (Python 3.11). `setup/lock.sh` makes it anew from pyproject.toml.'
    "$scratch/venv/bin/pip" freeze --all --disable-pip-version-check | grep -v '^pip==' | sort -f
} >requirements.lock
