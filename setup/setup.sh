#!/usr/bin/env bash
# Makes a fresh Debian 12 machine ready to build and fly Noctule; called by every make target.
#
# Four steps, each skipped when its result is already there: system packages (packages.txt), the Python
# environment .venv (requirements.lock), Unity for the C++ tests, and the Python message types.
# Exit 2: system packages are missing and cannot be installed from here; one line says what to run.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD

say() { echo "setup: $*"; }

# ---- 1 system packages
mapfile -t packages < <(sed 's/#.*//; s/[[:space:]]//g; /^$/d' packages.txt)
missing=()
if command -v dpkg-query >/dev/null; then
    installed=$(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "${packages[@]}" 2>/dev/null | sed -n 's/^installed //p' || true)
    for package in "${packages[@]}"; do
        grep -qx "$package" <<<"$installed" || missing+=("$package")
    done
else
    echo "setup: this is not a Debian system; install what stands for these Debian 12 packages, then build with cmake: ${packages[*]}" >&2
    exit 2
fi
if [ ${#missing[@]} -gt 0 ]; then
    as_root=()
    if [ "$(id -u)" != 0 ]; then
        if command -v sudo >/dev/null && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
            as_root=(sudo)
        else
            echo "setup: run this once as root, then make again:  apt-get update && apt-get install -y --no-install-recommends ${missing[*]}" >&2
            exit 2
        fi
    fi
    say "installing ${#missing[@]} system packages: ${missing[*]}"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq update
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "${missing[@]}" >/dev/null
fi

# ---- 2 Python environment. Debian's own python3 first: elsewhere in PATH a version manager's shim may stand in front.
python=
for candidate in /usr/bin/python3 python3.13 python3.12 python3.11 python3; do
    if command -v "$candidate" >/dev/null && "$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    echo "setup: no Python 3.11 or newer with venv was found" >&2
    exit 2
fi
# The stamp holds what the environment was made from; the folder too, since an environment cannot be moved.
want=$(cat requirements.lock pyproject.toml setup/setup.sh | sha256sum | cut -d' ' -f1)" $root"
if [ "$(cat .venv/noctule.stamp 2>/dev/null || true)" != "$want" ]; then
    [ "$(cat .venv/noctule.root 2>/dev/null || true)" = "$root" ] || rm -rf .venv
    if [ ! -x .venv/bin/python ]; then
        say "making the Python environment .venv ($("$python" --version))"
        "$python" -m venv .venv
        echo "$root" >.venv/noctule.root
    fi
    say "installing the Python packages of requirements.lock (about 300 MB the first time)"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
    say "installing the noctule command into .venv/bin"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    # Generated Python (message types) lives in the build folder; a .pth file makes it importable.
    site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_paths()["purelib"])')
    echo "$root/build/generated/python" >"$site/noctule_generated.pth"
    echo "$want" >.venv/noctule.stamp
fi

# ---- 3 Unity
if [ -z "${UNITY_DIR:-}" ] && [ ! -f build/deps/unity.stamp ]; then
    say "fetching Unity 2.5.1 (C++ test framework) from Debian's ntpsec source package"
    mkdir -p build/deps
    setup/fetch_unity.sh "$root/build/deps/unity"
    touch build/deps/unity.stamp
fi

# ---- 4 message types and parameter defaults for Python
stamp=build/generated/python.stamp
if [ ! -f $stamp ] || [ -n "$(find firmware/interface host/noctule/generate -newer $stamp \( -name '*.lcm' -o -name '*.toml' -o -name '*.py' \) -print -quit)" ]; then
    say "generating the Python message types and parameter defaults"
    .venv/bin/python -m noctule.generate python --out build/generated/python
    touch $stamp
fi
