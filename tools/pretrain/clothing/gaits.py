"""Cycles of motion for the clothed people: a pose at every phase, the same at phase 0 and 1.

Legs follow the key angles of ordinary gaits (heel strike, mid-stance, push-off, swing) through periodic cubics; a
phase of 0 is the left heel's strike, and the right leg is half a cycle behind.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from cloak_core.core.cameras import Number
from cloak_core.sources.bodies.people.skeleton import Arm, Leg, Pose

Keys = tuple[tuple[Number, ...], ...]
# Of one leg: share of the cycle, thigh forwards, knee bent, sole's pitch (heel up), in degrees.
WALK = (
    (0.0, 24, 4, -14),
    (0.12, 18, 15, 0),
    (0.35, -2, 6, 0),
    (0.52, -15, 12, 18),
    (0.62, -8, 38, 42),
    (0.74, 14, 58, 34),
    (0.87, 27, 26, 2),
)
RUN = (
    (0.0, 30, 18, 2),
    (0.12, 20, 36, 0),
    (0.36, -18, 20, 40),
    (0.52, -8, 72, 74),
    (0.68, 24, 98, 62),
    (0.82, 44, 72, 22),
    (0.93, 38, 30, 4),
)


@lru_cache(maxsize=8)
def _curve(table: Keys) -> CubicSpline:
    """Thigh, knee and sole over the phase."""
    keys = np.array([*table, (1.0, *table[0][1:])], float)
    return CubicSpline(keys[:, 0], keys[:, 1:], bc_type="periodic")


def _leg(table: Keys, phase: Number, reach: Number, outward: Number) -> Leg:
    hip, knee, heel_up = _curve(table)(phase % 1)
    return Leg(
        hip=hip * reach, abduction=2.5, outward=outward, knee=max(knee * (0.4 + 0.6 * reach), 1.0), heel_up=heel_up
    )


def walk(phase: Number, reach: Number = 1.0, swing: Number = 22.0, lean: Number = 2.0) -> Pose:
    """Walking; `reach` scales the step, `swing` is the arms' in degrees."""
    beat = np.cos(2 * np.pi * phase)

    def arm(beat: Number) -> Arm:
        elbow = 16 + 0.5 * swing * max(beat, 0)
        return Arm(shoulder=2 + swing * beat, abduction=15, inward=12, elbow=elbow, pronation=18)

    turn = -4.0 * reach * beat
    return Pose(
        left_leg=_leg(WALK, phase, reach, 6),
        right_leg=_leg(WALK, phase + 0.5, reach, 6),
        left_arm=arm(-beat),
        right_arm=arm(beat),
        turn=turn,
        spine_turn=-2 * turn,
        tilt=2.0 * np.sin(2 * np.pi * phase),
        spine_tilt=-2.0 * np.sin(2 * np.pi * phase),
        lean=lean,
    )


def run(phase: Number, reach: Number = 1.0, drive: Number = 32.0, lean: Number = 7.0) -> Pose:
    """Running; `drive` is the arms' swing in degrees."""
    beat = np.cos(2 * np.pi * (phase + 0.08))

    def arm(beat: Number) -> Arm:
        inward, elbow = 8 + 14 * beat, 90 + 6 * beat
        return Arm(shoulder=-6 + drive * beat, abduction=22, inward=inward, elbow=elbow, pronation=10, curl=40)

    turn = -7.0 * reach * beat
    return Pose(
        left_leg=_leg(RUN, phase, reach, 3),
        right_leg=_leg(RUN, phase + 0.5, reach, 3),
        left_arm=arm(-beat),
        right_arm=arm(beat),
        turn=turn,
        spine_turn=-2 * turn,
        lean=lean,
        spine_lean=4.0,
    )


def wave(phase: Number, raised: Number = 82.0, right: bool = True) -> Pose:
    """Standing with one hand up that goes from side to side."""
    beat = np.sin(2 * np.pi * phase)
    up = Arm(
        shoulder=20, abduction=raised + 3 * beat, inward=-78 + 9 * beat, elbow=88 + 14 * beat, pronation=20, curl=4
    )
    down = Arm(abduction=16, elbow=16)
    arms = {"right_arm": up, "left_arm": down} if right else {"left_arm": up, "right_arm": down}
    return Pose(spine_tilt=(2.0 + beat) * (1 if right else -1), **arms)


def stand(phase: Number, sway: Number = 1.0, elbow: Number = 20.0) -> Pose:
    """Standing, the weight going from one leg to the other, the chest turning a little."""
    beat = sway * np.sin(2 * np.pi * phase)
    leg = lambda side: Leg(hip=4 + 4 * side * beat, abduction=5, outward=10, knee=8 + 7 * side * beat)
    return Pose(
        left_leg=leg(1.0),
        right_leg=leg(-1.0),
        left_arm=Arm(shoulder=3 + 5 * beat, abduction=17, elbow=elbow),
        right_arm=Arm(shoulder=3 - 4 * beat, abduction=16, elbow=elbow + 6),
        spine_turn=5 * beat,
        spine_tilt=1.5 * beat,
        look_left=-6 * beat,
    )


CYCLES = {"walking": walk, "running": run, "waving": wave, "standing": stand}
"""A pose for a phase, by the motion's name."""
