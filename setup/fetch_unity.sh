#!/usr/bin/env bash
# Fetches Unity 2.5.1 (the C test framework, MIT) into DIR: fetch_unity.sh DIR
#
# No Debian binary package ships Unity; the Debian source package ntpsec carries it unmodified in tests/unity.
# The download goes through apt with a source list of its own, so the machine's /etc/apt is not touched.
# Unity is taken from the original tarball, whose sum is pinned, not from a Debian revision.
set -euo pipefail

dir=$1
tarball_sha256=53e527e3d04d551d41af2d359c2715c2de5f5bfa2a695d4ec1a811b3e9137f63
# The three files that the tests need; checked so that a half-written folder is not taken for a copy.
files_sha256="2e3a0610268455520a5796345b503d00c34a47fe97ed3750349cbd4b2b1990f3  unity.c
681ac98a63ac11effb11e59d580f6ca82abca1bd34069465c38e3b15344256c0  unity.h
adfd612c217e59468c5ebe978640e77e5f539e820ffc0c195a98c5a36f0ac868  unity_internals.h"

complete() { (cd "$dir" 2>/dev/null && echo "$files_sha256" | sha256sum --check --status 2>/dev/null); }
complete && exit 0

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir -p "$scratch/lists/partial" "$scratch/cache/archives/partial" "$scratch/src"
chmod -R a+rX "$scratch"

# The first Debian mirror this machine is set up with; the main one where none is found.
mirror=$(awk '/^URIs:/{print $2; exit}' /etc/apt/sources.list.d/debian.sources 2>/dev/null || true)
[ -n "$mirror" ] || mirror=$(awk '$1=="deb"{for(i=2;i<=NF;i++) if($i ~ /^https?:/){print $i; exit}}' /etc/apt/sources.list 2>/dev/null || true)
[ -n "$mirror" ] || mirror=http://deb.debian.org/debian
cat >"$scratch/src.sources" <<EOF
Types: deb-src
URIs: $mirror
Suites: bookworm
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
EOF
options=(-qq -o Dir::Etc::SourceList=/dev/null -o "Dir::Etc::SourceParts=$scratch" -o "Dir::State::Lists=$scratch/lists"
    -o "Dir::Cache=$scratch/cache" -o APT::Sandbox::User=)
apt-get "${options[@]}" update
(cd "$scratch/src" && apt-get "${options[@]}" source --download-only ntpsec)

tarball=$(find "$scratch/src" -name 'ntpsec_*.orig.tar.*' ! -name '*.asc' | head -1)
if [ "$(sha256sum <"$tarball" | cut -d' ' -f1)" != "$tarball_sha256" ]; then
    echo "setup: the ntpsec source tarball has another sum than the pinned one; Unity was not installed" >&2
    exit 1
fi
mkdir -p "$scratch/out" "$dir"
tar -xf "$tarball" -C "$scratch/out" --strip-components=1 --wildcards '*/tests/unity/*'
cp "$scratch"/out/tests/unity/unity{.c,.h,_internals.h} "$dir/"
if ! complete; then
    echo "setup: the copy of Unity in $dir is not the expected one" >&2
    exit 1
fi
