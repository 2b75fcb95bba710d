#!/bin/bash
# Blender's window on a screen of its own (Xvfb, OpenGL in software), and a script that runs in it.
#
#   tools/blender/window.sh [OUT.png] SCRIPT.py [ARG ...]
#
# OUT.png is a picture of the screen when the script makes the file that $SHOT_READY names; scripts may take more of
# their own. Ends with Blender's exit code: 3 after an error in the script, 124 past the limit. BLENDER names another
# `blender`, SCREEN another size than 1600x1000, SECONDS_LIMIT another limit than 1800. Needs Xvfb, xdotool, and
# ImageMagick's `import`. In a chroot that has all of it: `real_blender.sh run sid tools/blender/window.sh ...`.
set -euo pipefail
OUT=""; [[ $1 == *.png ]] && { OUT=$(realpath -m "$1"); shift; }
SCRIPT=$(realpath "$1"); shift
SCREEN=${SCREEN:-1600x1000} LIBGL_ALWAYS_SOFTWARE=1
folder=$(mktemp -d)
export SHOT_READY=$folder/shot_ready LIBGL_ALWAYS_SOFTWARE BLENDER_USER_RESOURCES=${BLENDER_USER_RESOURCES:-$folder/user}
Xvfb -displayfd 9 -screen 0 "${SCREEN}x24" +extension GLX -nolisten tcp 9>"$folder/display" 2>/dev/null & screen=$!
trap 'kill $screen 2>/dev/null; rm -rf "$folder"' EXIT
until [ -s "$folder/display" ]; do sleep 0.1; done
DISPLAY=:$(cat "$folder/display"); export DISPLAY
timeout "${SECONDS_LIMIT:-1800}" "${BLENDER:-blender}" --factory-startup -p 0 0 "${SCREEN%x*}" "${SCREEN#*x}" \
    --python-exit-code 3 -P "$SCRIPT" -- "$@" & blender=$!
if [ -n "$OUT" ]; then
    while [ ! -e "$SHOT_READY" ] && kill -0 $blender 2>/dev/null; do sleep 0.2; done
    sleep 1.5; import -window root "$OUT" || true
fi
code=0; wait $blender || code=$?
exit $code
