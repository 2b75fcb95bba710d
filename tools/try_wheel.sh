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
# An empty file of every family: one line that says what is missing or wrong, whatever extras there are.
touch a.onnx a.pt a.xml a.tflite a.cfg a.weights a.pth a.py
for spec in a.onnx a.pt a.xml a.tflite a.cfg torchvision:ssd300_vgg16:a.pth transformers:RUN python:a.py:load; do
    code=0
    "$bin/cloak" detectors check "$spec" --image "$(ls RUN/previews/*.png | head -1)" 2>said || code=$?
    cat said
    [ "$code" = 2 ] && ! grep -q Traceback said
done
echo "$(basename "$file") does what the README says on $("$bin/python" -V), in $folder"
