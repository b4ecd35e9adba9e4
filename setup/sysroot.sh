#!/usr/bin/env bash
# Makes a machine ready to cross-compile for ARCH: sysroot.sh arm64 | armhf | cortex-m7
#
# Installs the cross compiler and qemu from Debian (only here: `make test` needs neither) and, for the two Linux boards,
# unpacks the foreign libraries into build/deps/sysroot-ARCH: multiarch beside amd64 does not resolve for OpenCV.
# Quick when everything is there. SYSROOT_DIR= puts the sysroots elsewhere.
set -euo pipefail
cd "$(dirname "$0")/.."

arch=${1:?usage: setup/sysroot.sh arm64 | armhf | cortex-m7}
case $arch in
    arm64) tools=(mmdebstrap qemu-user g++-aarch64-linux-gnu) ;;
    armhf) tools=(mmdebstrap qemu-user g++-arm-linux-gnueabihf) ;;
    cortex-m7) tools=(gcc-arm-none-eabi libstdc++-arm-none-eabi-newlib libnewlib-arm-none-eabi qemu-system-arm) ;;
    *) echo "sysroot: $arch is none of arm64, armhf, cortex-m7" >&2; exit 2 ;;
esac

missing=()
for package in "${tools[@]}"; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" != 0 ]; then
        echo "sysroot: run this once as root:  apt-get install -y --no-install-recommends ${missing[*]}" >&2
        exit 2
    fi
    echo "sysroot: installing ${missing[*]}"
    apt-get -qq update || true  # an index that cannot be had now must not stop what is known already
    DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "${missing[@]}" >/dev/null
fi
[ "$arch" != cortex-m7 ] || exit 0

# What the processes link or include; the header-only ones too, so that nothing is found outside the sysroot.
include=libc6-dev,libstdc++-12-dev,libeigen3-dev,liblcm-dev,libglib2.0-dev,libsqlite3-dev,libopencv-core-dev
include+=,libopencv-imgproc-dev,libopencv-features2d-dev,libtomlplusplus-dev,libcli11-dev
folder=${SYSROOT_DIR:-build/deps}/sysroot-$arch
[ "$(cat "$folder/noctule.stamp" 2>/dev/null || true)" != "$include" ] || exit 0

echo "sysroot: unpacking $arch into $folder (about 800 MB, a minute)"
mirror=$(awk '/^URIs:/{print $2; exit}' /etc/apt/sources.list.d/debian.sources 2>/dev/null || true)
[ -n "$mirror" ] || mirror=http://deb.debian.org/debian
mode=root
[ "$(id -u)" = 0 ] || mode=unshare
rm -rf "$folder"
mkdir -p "$(dirname "$folder")"
mmdebstrap --quiet --variant=extract --mode=$mode --architectures="$arch" --include="$include" \
    --aptopt='APT::Install-Recommends "false"' bookworm "$folder" "deb $mirror bookworm main"
rm -rf "$folder"/usr/share/{doc,man,locale} "$folder"/var/cache/apt "$folder"/var/lib/apt/lists "$folder"/dev
echo "$include" >"$folder/noctule.stamp"
