#!/usr/bin/env bash
# Makes requirements.lock anew: the newest versions that pyproject.toml allows, in an environment of their own.
set -euo pipefail
cd "$(dirname "$0")/.."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
/usr/bin/python3 -m venv "$scratch/venv"
mapfile -t wanted < <("$scratch/venv/bin/python" -c '
import tomllib
project = tomllib.load(open("pyproject.toml", "rb"))
for line in project["build-system"]["requires"] + project["project"]["dependencies"] + project["project"]["optional-dependencies"]["test"]:
    print(line)')
"$scratch/venv/bin/pip" install --quiet --disable-pip-version-check --upgrade "${wanted[@]}" wheel
{
    echo '# Exact versions of everything in .venv (Python 3.11). `setup/lock.sh` makes it anew from pyproject.toml.'
    "$scratch/venv/bin/pip" freeze --all --disable-pip-version-check | grep -v '^pip==' | sort -f
} >requirements.lock
