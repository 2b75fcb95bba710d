#!/bin/sh
# Install the wheel (or the sources) of a folder into an environment of its own, and type the README's commands there,
# made short: `PYTHON=python3.13 tools/try_wheel.sh [FILE]`; FILE is dist/*.whl where it is not named.
# EXTRAS=onnx,film installs these as well. Runs on Linux, macOS, and in the bash of Windows.
set -eu
file=${1:-$(ls dist/*.whl)}
file=$(cd "$(dirname "$file")" && pwd)/$(basename "$file")
folder=$(mktemp -d)
cd "$folder" # from here nobody sees the checkout
unset PYTHONPATH
"${PYTHON:-python3}" -m venv environment
bin=$folder/environment/bin
[ -d "$bin" ] || bin=$folder/environment/Scripts
"$bin/python" -m pip install -q --disable-pip-version-check "$file${EXTRAS:+[$EXTRAS]}"
"$bin/cloak" version
"$bin/cloak" train --logo chest+thighs --out RUN --steps 20 --batch 2 --size 160 --translation 16 --samples 4
"$bin/cloak" evaluate RUN --samples 4 --size 160 --shift 16 --most-images 8 --bare 16
"$bin/cloak" report RUN
test -s RUN/report.html
echo "$(basename "$file") does what the README says on $("$bin/python" -V), in $folder"
