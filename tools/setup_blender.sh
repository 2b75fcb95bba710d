#!/bin/sh
# Make .venv-blender: Blender 4.5 LTS as a Python package (370 MB) and pytest, for `make extension` and tests/blender.
# It is apart from .venv because bpy holds numpy below 2, and because Blender and torch cannot share a process.
# `tools/setup_blender.sh 5.0.1` makes .venv-blender-5.0.1 with that version. Needs CPython 3.11.
set -eu
cd "$(dirname "$0")/.."

VERSION=${1:-4.5.*}
FOLDER=.venv-blender${1:+-$1}
LIBRARIES="libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1"

missing=
for package in $LIBRARIES; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
done
if [ -n "$missing" ] && command -v apt-get >/dev/null; then
    if [ "$(id -u)" = 0 ]; then
        echo "installing for Blender:$missing" >&2
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
    else
        echo "Blender needs these packages; as root: apt-get install$missing" >&2
        exit 2
    fi
fi

PYTHON=${PYTHON:-$(command -v python3.11 || command -v python3)}
"$PYTHON" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { echo "bpy needs CPython 3.11, not $("$PYTHON" -V)" >&2; exit 2; }
[ -x "$FOLDER/bin/python" ] || "$PYTHON" -m venv "$FOLDER"
echo "installing bpy $VERSION into $FOLDER" >&2
"$FOLDER/bin/python" -m pip install -q --disable-pip-version-check "bpy==$VERSION" pytest
"$FOLDER/bin/python" -c 'import bpy, sys; print("Blender", bpy.app.version_string, file=sys.stderr); sys.stderr.flush(); import os; os._exit(0)'
