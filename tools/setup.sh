#!/usr/bin/env bash
# Make .venv: `setup.sh base` for the tool, `setup.sh dev` for its tests as well.
# Debian packages are installed where apt may be used: as root, or through sudo.
set -euo pipefail
cd "$(dirname "$0")/.."
readonly stage="${1:?usage: setup.sh base|dev}"

say() { printf 'setup: %s\n' "$*" >&2; }

apt_install() {
    command -v apt-get >/dev/null || return 1
    local run=()
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || return 1
        run=(sudo)
        [ -t 0 ] || run=(sudo -n)
    fi
    say "installing from Debian: $*"
    "${run[@]}" apt-get update -qq >/dev/null 2>&1 || true
    "${run[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "$@" >/dev/null 2>&1
}

usable_python() {
    "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

find_python() {
    local candidate
    for candidate in /usr/bin/python3 python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null && usable_python "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    return 1
}

has_aravis() {
    [ -x /usr/bin/python3 ] && /usr/bin/python3 -c \
        'import gi; gi.require_version("Aravis", "0.8"); from gi.repository import Aravis' 2>/dev/null
}

# The venv stays closed to system packages; only Aravis' binding is let in, by a link.
link_gi() {
    local version='import sys; print(sys.version_info[:2])'
    [ "$(/usr/bin/python3 -c "$version")" = "$(.venv/bin/python -c "$version")" ] || return 1
    local site
    site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    ln -sfn /usr/lib/python3/dist-packages/gi "$site/gi"
}

make_base() {
    local python
    if ! python=$(find_python); then
        apt_install python3 python3-venv || true
        python=$(find_python) || {
            say "no Python >= 3.11 with venv here: apt-get install python3-venv, then run again"
            exit 1
        }
    fi
    has_aravis || apt_install python3-gi gir1.2-aravis-0.8 aravis-tools-cli || true
    [ -x .venv/bin/python ] || "$python" -m venv .venv
    say "installing Python packages into .venv"
    .venv/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
    if ! has_aravis || ! link_gi; then
        say "real cameras are unavailable (no python3-gi with gir1.2-aravis-0.8); all else works"
    fi
    touch .venv/.base
}

make_dev() {
    command -v chromium >/dev/null || apt_install chromium ||
        say "no chromium: the report's browser tests will be skipped"
    if has_aravis && ! command -v arv-camera-test-0.8 >/dev/null; then
        apt_install aravis-tools ||
            say "no aravis-tools: tests with Aravis' own programs will be skipped"
    fi
    if ! command -v gcc >/dev/null || [ ! -f /usr/include/libusb-1.0/libusb.h ]; then
        apt_install gcc libc6-dev libusb-1.0-0-dev ||
            say "no gcc with libusb-1.0-0-dev: tests over USB without a bus will be skipped"
    fi
    say "installing the test tools and torch into .venv"
    .venv/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[train,dev]'
    touch .venv/.dev
}

"make_$stage"
