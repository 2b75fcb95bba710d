#!/bin/sh
# Make .venv with the project in it: `tools/setup.sh`, or `tools/setup.sh test` for what the tests need as well.
# System libraries that a package needs are installed when this runs as root, and named when it does not.
set -eu
cd "$(dirname "$0")/.."

need() { # need WHAT-FOR PACKAGE...: Debian packages that are not there yet
    why=$1; shift; missing=
    for package in "$@"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
    done
    [ -z "$missing" ] && return
    if [ "$(id -u)" = 0 ]; then
        echo "installing for $why:$missing" >&2
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
    else
        echo "$why needs these packages; as root: apt-get install$missing" >&2
        exit 2
    fi
}

PYTHON=${PYTHON:-$(command -v python3.11 || command -v python3)}
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, not $("$PYTHON" -V)" >&2; exit 2; }
if [ ! -x .venv/bin/python ]; then
    "$PYTHON" -c 'import ensurepip' 2>/dev/null || need "a virtual environment" python3-venv
    "$PYTHON" -m venv .venv
    # A torch that this Python has already spares the download, whether it is for CUDA or for the CPU alone.
    if packages=$("$PYTHON" tools/find_torch.py); then
        echo "using the torch in $packages" >&2
        echo "$packages" >"$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/torch.pth"
    else
        echo "torch from the registry brings CUDA: about 5 GB, a few minutes (activate an environment that has torch" \
            "and torchvision, or name its PYTHON, to use that one instead)" >&2
    fi
fi
# What OpenCV is linked against, which ultralytics brings.
[ "${1:-}" != test ] || need "the tests of ultralytics" libgl1 libglib2.0-0
extras=${1:+"[$1]"}
# Progress where somebody looks on, silence in a log.
quiet=-q; [ ! -t 1 ] || quiet=
other=$(.venv/bin/python tools/editable_elsewhere.py)
if [ -n "$other" ]; then
    # Another checkout shares this environment: its commands must go on running its own code.
    echo "installing what cloak$extras needs into .venv, and leaving cloak itself to $other" >&2
    needs=$(mktemp)
    .venv/bin/python tools/list_requirements.py ${1:-} >"$needs"
    .venv/bin/python -m pip install $quiet --disable-pip-version-check -r "$needs"
    rm -f "$needs"
else
    echo "installing cloak$extras into .venv" >&2
    .venv/bin/python -m pip install $quiet --disable-pip-version-check -e ".$extras"
fi
# The first picture waits for no compiler.
.venv/bin/python -m cloak_core.studies.first_view >&2
# The public SMPL code, to check ours against; its own list of needs would bring chumpy and more, none of it needed.
[ "${1:-}" != test ] || .venv/bin/python -m pip install -q --disable-pip-version-check --no-deps smplx
