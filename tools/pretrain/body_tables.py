"""The tables behind the sample bodies: shapes, poses and outfits, all made by hand."""

from __future__ import annotations

from dataclasses import dataclass

from cloak_core.sources.bodies.people.motions import running, walking, waving
from cloak_core.sources.bodies.people.skeleton import Arm, Leg, Pose

PARTS = ("torso", "hips", "arms", "forearms", "hands", "thighs", "shins", "feet", "head", "hair", "eyes", "mouth")


@dataclass(frozen=True)
class BodySpec:
    """One sample body; `shape` in Anny's phenotypes: gender 0 male to 1 female, age 0.67 young to 1 old, else 0..1."""

    name: str
    shape: dict[str, float]
    pose: Pose


def shape(gender: float, age: float, muscle: float, weight: float, height: float, **more: float) -> dict[str, float]:
    return {"gender": gender, "age": age, "muscle": muscle, "weight": weight, "height": height, **more}


def arms(left: Arm, right: Arm | None = None) -> dict[str, Arm]:
    """Both arms; alike unless told otherwise."""
    return {"left_arm": left, "right_arm": right or left}


def legs(left: Leg, right: Leg | None = None) -> dict[str, Leg]:
    """Both legs; alike unless told otherwise."""
    return {"left_leg": left, "right_leg": right or left}


WIDE = Arm(abduction=18, inward=14, elbow=16)
ON_HIP = Arm(shoulder=-14, abduction=47, inward=42, elbow=84, pronation=30, curl=22)

TRAIN = (
    BodySpec("standing-01", shape(0.05, 0.68, 0.55, 0.50, 0.33), Pose()),
    BodySpec(
        "standing-02",
        shape(0.95, 0.66, 0.50, 0.45, 0.36, cupsize=0.55),
        Pose(**arms(Arm(abduction=13, elbow=18), Arm(shoulder=6, abduction=12)), look_left=12, tilt=2),
    ),
    BodySpec(
        "standing-03", shape(0.0, 0.82, 0.45, 0.85, 0.29), Pose(**arms(WIDE), **legs(Leg(abduction=6, outward=14)))
    ),
    BodySpec(
        "standing-04",
        shape(1.0, 0.90, 0.40, 0.78, 0.28, cupsize=0.6),
        Pose(**arms(WIDE, Arm(abduction=17, inward=22, elbow=28)), look_down=4),
    ),
    BodySpec(
        "standing-05",
        shape(0.1, 0.64, 0.90, 0.60, 0.42, african=0.9, asian=0.1, caucasian=0.1),
        Pose(**arms(Arm(abduction=20, elbow=20)), **legs(Leg(abduction=8, outward=12))),
    ),
    BodySpec(
        "standing-06",
        shape(0.9, 0.72, 0.55, 0.35, 0.54, asian=0.9, african=0.1, caucasian=0.1),
        Pose(**arms(ON_HIP, Arm(abduction=12)), tilt=-3, spine_tilt=4, look_left=-8),
    ),
    BodySpec(
        "standing-07",
        shape(0.2, 0.95, 0.30, 0.40, 0.19, proportions=0.7),
        Pose(
            **arms(Arm(shoulder=8, elbow=22), Arm(shoulder=6, elbow=26)),
            **legs(Leg(hip=4, knee=9)),
            spine_lean=8,
            look_down=2,
        ),
    ),
    BodySpec(
        "standing-08",
        shape(0.5, 0.70, 0.65, 0.55, 0.41),
        Pose(
            **arms(Arm(shoulder=22, abduction=16, inward=34, elbow=82, pronation=30), Arm(abduction=12, elbow=14)),
            right_leg=Leg(hip=8, abduction=7, knee=12, outward=16),
        ),
    ),
    BodySpec(
        "standing-09",
        shape(0.8, 0.62, 0.75, 0.52, 0.39, african=0.8, asian=0.1, caucasian=0.2),
        Pose(
            **arms(Arm(abduction=38, inward=4, elbow=24), Arm(abduction=34, inward=6, elbow=30)),
            **legs(Leg(abduction=10, outward=14)),
            look_left=-14,
        ),
    ),
    BodySpec("walking-01", shape(0.0, 0.70, 0.60, 0.42, 0.36), walking(24)),
    BodySpec("walking-02", shape(1.0, 0.69, 0.45, 0.50, 0.32, cupsize=0.45), walking(22, left_first=False)),
    BodySpec("walking-03", shape(0.15, 0.78, 0.50, 0.72, 0.40), walking(20, swing=20, look_left=10)),
    BodySpec(
        "walking-04",
        shape(0.85, 0.86, 0.45, 0.62, 0.38, asian=0.8, african=0.1, caucasian=0.2),
        walking(17, left_first=False, swing=15, look_down=5),
    ),
    BodySpec("walking-05", shape(0.1, 0.63, 0.80, 0.48, 0.48), walking(29, left_first=False, swing=32, lean=3)),
    BodySpec("walking-06", shape(0.7, 0.67, 0.60, 0.30, 0.43, proportions=0.6), walking(27, swing=28, look_left=-12)),
    BodySpec(
        "walking-07",
        shape(0.3, 0.74, 0.40, 0.58, 0.25, african=0.7, asian=0.3, caucasian=0.2),
        walking(
            14,
            **arms(Arm(shoulder=-12, abduction=15), Arm(shoulder=15, abduction=15, elbow=22)),
            **legs(Leg(hip=8, abduction=1, knee=5), Leg(hip=14, abduction=1, knee=52, heel_up=38)),
        ),
    ),
    BodySpec(
        "walking-08",
        shape(0.95, 0.64, 0.65, 0.40, 0.52, cupsize=0.35),
        walking(
            14,
            left_first=False,
            **arms(Arm(shoulder=16, abduction=15, elbow=22), Arm(shoulder=-13, abduction=15)),
            **legs(Leg(hip=22, abduction=1, knee=46, heel_up=18), Leg(hip=2, abduction=1, knee=4)),
        ),
    ),
    BodySpec("walking-09", shape(0.0, 0.92, 0.38, 0.66, 0.26), walking(15, swing=13, spine_lean=6, look_down=6)),
    BodySpec("running-01", shape(0.05, 0.66, 0.75, 0.38, 0.35), running(52)),
    BodySpec("running-02", shape(0.95, 0.68, 0.68, 0.36, 0.39, cupsize=0.3), running(46, left_first=False)),
    BodySpec(
        "running-03", shape(0.2, 0.75, 0.55, 0.60, 0.34), running(38, left_first=False, drive=28, folded=70, lean=5)
    ),
    BodySpec(
        "running-04",
        shape(0.9, 0.65, 0.60, 0.50, 0.48, african=0.9, asian=0.1, caucasian=0.1),
        running(42, drive=32, folded=95),
    ),
    BodySpec(
        "running-05", shape(0.0, 0.62, 0.85, 0.45, 0.42), running(62, left_first=False, drive=44, folded=104, lean=10)
    ),
    BodySpec("running-06", shape(0.6, 0.80, 0.50, 0.55, 0.30), running(32, drive=24, folded=60, lean=4)),
)

UNSEEN = (
    BodySpec(
        "standing-10",
        shape(0.35, 0.73, 0.70, 0.68, 0.32, caucasian=0.9, african=0.2, asian=0.2),
        Pose(
            **arms(
                Arm(shoulder=10, abduction=22, inward=20, elbow=38), Arm(shoulder=-6, abduction=15, inward=8, elbow=14)
            ),
            **legs(Leg(hip=10, abduction=5, outward=10, knee=14), Leg(abduction=5, outward=12)),
            turn=6,
            spine_turn=-6,
        ),
    ),
    BodySpec(
        "waving-01",
        shape(0.92, 0.70, 0.58, 0.56, 0.45, cupsize=0.5, asian=0.6, caucasian=0.5, african=0.1),
        waving(),
    ),
    BodySpec(
        "walking-10",
        shape(0.08, 0.77, 0.62, 0.54, 0.44, proportions=0.65),
        walking(26, swing=22, look_left=16, lean=3),
    ),
    BodySpec(
        "walking-11",
        shape(0.88, 0.84, 0.50, 0.46, 0.26, cupsize=0.5),
        walking(
            19,
            left_first=False,
            swing=18,
            left_arm=Arm(shoulder=16, abduction=17, inward=24, elbow=62, pronation=20),
            look_left=-10,
        ),
    ),
    BodySpec(
        "running-07",
        shape(0.12, 0.71, 0.66, 0.52, 0.28, asian=0.9, african=0.1, caucasian=0.1),
        running(44, drive=38, folded=78, lean=6, look_left=8),
    ),
    BodySpec(
        "running-08",
        shape(0.75, 0.67, 0.78, 0.44, 0.51, cupsize=0.4),
        running(56, left_first=False, drive=30, folded=98, lean=8, look_left=-10),
    ),
)
"""Bodies that nothing is trained on."""

BODIES: tuple[BodySpec, ...] = TRAIN + UNSEEN

Color = tuple[int, int, int]


def outfit(
    skin: Color,
    hair: Color,
    shirt: Color,
    trousers: Color,
    shoes: Color,
    short_sleeves: bool = False,
    shorts: bool = False,
) -> dict[str, Color]:
    """sRGB bytes of every part."""
    return {
        "torso": shirt,
        "arms": shirt,
        "forearms": skin if short_sleeves else shirt,
        "hands": skin,
        "hips": trousers,
        "thighs": trousers,
        "shins": skin if shorts else trousers,
        "feet": shoes,
        "head": skin,
        "hair": hair,
        "eyes": (70, 60, 55),
        "mouth": (120, 60, 60),
    }


OUTFITS: tuple[dict[str, Color], ...] = (
    outfit((224, 172, 140), (60, 42, 30), (176, 48, 44), (42, 52, 84), (40, 36, 34)),
    outfit((141, 85, 54), (24, 20, 18), (222, 218, 206), (58, 58, 62), (92, 64, 44), short_sleeves=True),
    outfit((241, 201, 172), (196, 158, 98), (54, 108, 72), (120, 98, 70), (66, 60, 58)),
    outfit((88, 54, 38), (18, 16, 16), (230, 170, 40), (32, 34, 40), (200, 200, 200), short_sleeves=True),
    outfit(
        (234, 188, 150), (30, 26, 26), (64, 112, 168), (182, 172, 150), (120, 80, 50), short_sleeves=True, shorts=True
    ),
    outfit((250, 214, 190), (150, 72, 36), (38, 38, 42), (86, 108, 142), (236, 234, 228)),
    outfit((198, 134, 96), (44, 32, 26), (150, 150, 156), (70, 44, 38), (30, 30, 32), short_sleeves=True),
    outfit((112, 70, 46), (30, 24, 22), (120, 58, 120), (206, 202, 194), (84, 84, 90)),
    outfit((228, 180, 148), (150, 150, 148), (236, 140, 110), (46, 70, 62), (50, 40, 36), short_sleeves=True),
    outfit((246, 206, 176), (92, 62, 40), (120, 178, 200), (26, 30, 44), (170, 48, 44), shorts=True),
    outfit((168, 108, 74), (20, 18, 20), (248, 246, 240), (150, 40, 48), (36, 36, 36)),
    outfit((216, 160, 124), (70, 60, 56), (92, 84, 52), (52, 50, 46), (110, 88, 60), short_sleeves=True),
)
