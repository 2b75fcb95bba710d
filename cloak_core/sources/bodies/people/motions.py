"""Poses of people in motion: moments of standing, walking, running and waving, made or drawn at random."""

from __future__ import annotations

import numpy as np

from cloak_core.core.cameras import Number
from cloak_core.sources.bodies.people.skeleton import Arm, Leg, Pose


def walking(step: Number, left_first: bool = True, swing: Number = 24.0, **changes: object) -> Pose:
    """Make a double-support or mid-stance moment of walking; `step`: the leading thigh's angle, `swing`: the arms'."""
    lead = Leg(hip=step, abduction=1.5, outward=5, knee=4, heel_up=-0.55 * step)
    trail = Leg(hip=-0.72 * step, abduction=1.5, outward=6, knee=0.5 * step + 3, heel_up=1.15 * step)
    back = Arm(shoulder=-0.85 * swing, abduction=12, inward=10, elbow=10, pronation=22)
    front = Arm(shoulder=swing, abduction=11, inward=14, elbow=12 + 0.6 * swing, pronation=14)
    turn = (-4.0 if left_first else 4.0) * step / 25
    return Pose(**({"lean": 2.0} | stride(left_first, lead, trail, back, front, turn) | changes))


def running(
    knee_up: Number,
    left_first: bool = True,
    drive: Number = 35.0,
    folded: Number = 85.0,
    lean: Number = 7.0,
    **changes: object,
) -> Pose:
    """Make a push-off moment of running: one knee comes up, the other leg pushes, the arms counter it."""
    lead = Leg(hip=knee_up, abduction=1, outward=2, knee=folded, heel_up=12)
    trail = Leg(hip=-16, abduction=1, outward=4, knee=22, heel_up=42)
    back = Arm(shoulder=-drive * 1.2, abduction=25, inward=-8, elbow=88, pronation=8, curl=42)
    front = Arm(shoulder=drive * 0.8, abduction=12, inward=24, elbow=96, pronation=12, curl=42)
    limbs = stride(left_first, lead, trail, back, front, turn=-7.0 if left_first else 7.0)
    return Pose(**({"lean": lean, "spine_lean": 4.0} | limbs | changes))


def stride(left_first: bool, lead: Leg, trail: Leg, back: Arm, front: Arm, turn: Number) -> dict[str, object]:
    """Make the limbs of a step; the arm on the leading leg's side swings back, the spine counters the pelvis' turn."""
    legs, arms = ((lead, trail), (back, front)) if left_first else ((trail, lead), (front, back))
    limbs = dict(zip(("left_leg", "right_leg", "left_arm", "right_arm"), legs + arms, strict=True))
    return limbs | {"turn": turn, "spine_turn": -2 * turn}


def waving(right: bool = True, raised: Number = 82.0, **changes: object) -> Pose:
    """Make a standing pose with one hand beside or above the head; `raised`: the upper arm's angle to the side."""
    up = Arm(shoulder=20, abduction=raised, inward=-78, elbow=92, pronation=20, curl=4)
    down = Arm(abduction=14, elbow=16)
    arms = {"right_arm": up, "left_arm": down} if right else {"left_arm": up, "right_arm": down}
    return Pose(**({"spine_tilt": 2.0 if right else -2.0, **arms} | changes))


def draw_standing(random: np.random.Generator) -> Pose:
    u = lambda low, high: float(random.uniform(low, high))
    arm = lambda: Arm(shoulder=u(-8, 22), abduction=u(9, 24), inward=u(4, 30), elbow=u(8, 60), pronation=u(5, 28))
    leg = lambda: Leg(hip=(hip := u(-1, 10)), abduction=u(2, 9), outward=u(3, 15), knee=1.3 * max(hip, 0) + u(1, 4))
    body = {"tilt": u(-3, 3), "spine_tilt": u(-4, 4), "spine_lean": u(-1, 7), "spine_turn": u(-6, 6)}
    return Pose(left_leg=leg(), right_leg=leg(), left_arm=arm(), right_arm=arm(), **body, **head(random))


def draw_walking(random: np.random.Generator) -> Pose:
    u = lambda low, high: float(random.uniform(low, high))
    left_first, swinging = bool(random.integers(2)), random.random() < 0.4
    changes: dict[str, object] = {"lean": u(1, 4), "spine_lean": u(0, 5)} | head(random)
    if swinging:
        # The free leg on its way past the standing one.
        names = ("right_leg", "left_leg") if left_first else ("left_leg", "right_leg")
        changes[names[0]] = Leg(hip=(hip := u(5, 24)), abduction=1, knee=u(40, 56), heel_up=38 - hip)
        changes[names[1]] = Leg(hip=u(0, 9), abduction=1, knee=u(3, 7))
    return walking(u(13, 30), left_first, swing=u(11, 32), **changes)


def draw_running(random: np.random.Generator) -> Pose:
    u = lambda low, high: float(random.uniform(low, high))
    return running(
        u(30, 64), bool(random.integers(2)), drive=u(22, 44), folded=u(58, 105), lean=u(4, 10), **head(random)
    )


def draw_waving(random: np.random.Generator) -> Pose:
    return waving(bool(random.integers(2)), float(random.uniform(65, 105)), **head(random))


def head(random: np.random.Generator) -> dict[str, float]:
    """Draw where the head looks."""
    down, left, tilt = (float(v) for v in random.uniform([-4, -18, -4], [8, 18, 4]))
    return {"look_down": down, "look_left": left, "head_tilt": tilt}


MOTIONS = {"standing": draw_standing, "walking": draw_walking, "running": draw_running, "waving": draw_waving}
"""Draws of one pose, by the motion's name."""
