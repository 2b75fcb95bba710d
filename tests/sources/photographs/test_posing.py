"""Poses of a made person: joints where they truly are, and what is taken where nobody tells depth, hands or a head."""

from collections.abc import Mapping

import numpy as np
import pytest

from cloak_core.sources.photographs.annotation import INDEX, Landmarks
from cloak_core.sources.photographs.posing import FORWARD, Posed, pose_to, seen_from
from cloak_core.sources.photographs.rig import NUMBER, SEGMENTS, body_rig
from tests.sources.photographs.made_people import SCALE, landmarks_of, standing

RIG = body_rig()
ENDS = ("heel", "toe", "hand")


def landmarks(
    posed: Posed, moved: Mapping[str, object] | None = None, depth: bool = False, unseen: str = ""
) -> Landmarks:
    """Landmarks of a made person; heels, toes and fingers are seen where they were moved (x and y down, and depth)."""
    at = landmarks_of(posed, RIG)
    visibility = np.array([0.0 if name.endswith(ENDS) or name in unseen.split() else 1.0 for name in INDEX])
    for name, place in (moved or {}).items():
        at[INDEX[name], : len(place)], visibility[INDEX[name]] = place, 1.0
    return Landmarks(at[:, :2], at[:, 2] if depth else None, visibility)


def joint(posed: Posed, name: str, segment: str) -> np.ndarray:
    return posed.joint(RIG, name, segment)


@pytest.mark.parametrize(
    ("azimuth", "swing", "side"), [(0, 0, "front"), (80, 0, "side"), (180, 0, "back"), (40, 20, "front")]
)
def test_a_pose_with_depth_is_the_true_one(azimuth: int, swing: int, side: str) -> None:
    true = standing(azimuth, swing)
    seen = landmarks(true, depth=True)
    found = pose_to(seen, RIG)
    away = np.linalg.norm(found.vertices(RIG) - true.vertices(RIG), axis=1) / SCALE
    mean = np.bincount(RIG.weights.argmax(axis=1), away) / np.bincount(RIG.weights.argmax(axis=1))
    assert found.scale == pytest.approx(SCALE, rel=1e-3) and seen_from(seen, RIG) == side
    assert all(mean[NUMBER[name]] < 0.01 for name in SEGMENTS if not name.endswith(("head", "foot")))


@pytest.mark.parametrize(("azimuth", "ahead"), [(0, 1), (180, -1)])
def test_without_depth_limbs_lean_the_way_that_they_bend(azimuth: int, ahead: int) -> None:
    """Thighs and forearms forwards, shins backwards, so far that they are as long as such a limb may be at least."""
    true = standing(azimuth)
    at, moved = landmarks_of(true, RIG)[:, :2], {}
    for start, end in (("l_hip", "l_knee"), ("l_knee", "l_ankle"), ("l_shoulder", "l_elbow"), ("l_elbow", "l_wrist")):
        moved[end] = moved.get(start, at[INDEX[start]]) + 0.8 * (at[INDEX[end]] - at[INDEX[start]])
    found = pose_to(landmarks(true, moved), RIG)
    assert found.scale == pytest.approx(SCALE, rel=0.01)
    for segment, start, end, sign in (
        ("l_thigh", "l_hip", "l_knee", ahead),
        ("l_shin", "l_knee", "l_ankle", -ahead),
        ("l_arm", "l_shoulder", "l_elbow", 0),
        ("l_forearm", "l_elbow", "l_wrist", ahead),
    ):
        limb = joint(found, end, segment) - joint(found, start, segment)
        length = np.linalg.norm(RIG.joints[end] - RIG.joints[start]) * found.scale
        assert np.sign(limb[2]) == sign and (not sign or np.linalg.norm(limb) == pytest.approx(0.85 * length))


@pytest.mark.parametrize("azimuth", [40, -40])
def test_without_depth_the_nose_tells_which_way_somebody_turns(azimuth: int) -> None:
    true = standing(azimuth)
    at = landmarks_of(true, RIG)[:, :2]
    nose = (at[INDEX["l_shoulder"]] + at[INDEX["r_shoulder"]]) / 2 + [np.sign(azimuth) * 15, -30]
    found = pose_to(landmarks(true, {"nose": nose}), RIG)
    across = joint(found, "l_shoulder", "chest") - joint(found, "r_shoulder", "chest")
    length = np.linalg.norm(RIG.joints["l_shoulder"] - RIG.joints["r_shoulder"]) * found.scale
    assert np.sign(-across[2]) == np.sign(azimuth) and np.linalg.norm(across) == pytest.approx(0.97 * length, rel=0.01)


def test_arms_out_of_sight_hang_behind_and_those_that_cross_the_trunk_lie_before_it() -> None:
    true = standing()
    found = pose_to(landmarks(true, unseen="l_elbow l_wrist"), RIG)
    shoulder, elbow, wrist = (
        joint(found, f"l_{name}", segment)
        for name, segment in (("shoulder", "chest"), ("elbow", "l_arm"), ("wrist", "l_forearm"))
    )
    upper = np.linalg.norm(RIG.joints["l_shoulder"] - RIG.joints["l_elbow"])
    hangs = shoulder[:2] - [0, upper * found.scale]
    assert (
        elbow[:2] == pytest.approx(hangs, abs=0.2)
        and wrist[0] == pytest.approx(hangs[0], abs=0.2)
        and wrist[1] < elbow[1]
    )
    assert elbow[2] == pytest.approx(-0.25 * found.scale) == wrist[2]
    for azimuth in (20, -20):
        bent = landmarks_of(standing(azimuth), RIG)[INDEX["l_elbow"]] + [0, -10, 40]
        hardly = landmarks(standing(azimuth), {"l_wrist": bent}, depth=True)
        hardly.visibility[INDEX["l_wrist"]] = 0.3
        found = pose_to(hardly, RIG)
        behind = min(joint(found, f"{side}_hip", f"{side}_thigh")[2] for side in "lr") - 0.25 * found.scale
        assert joint(found, "l_wrist", "l_forearm")[2] == pytest.approx(behind, abs=0.5), "before her, but not shown"
    for azimuth, depth in ((0, 0.16), (180, -0.2)):
        at = landmarks_of(standing(azimuth), RIG)[:, :2]
        across = (
            0.7 * at[INDEX["r_shoulder"]] + 0.3 * at[INDEX["l_shoulder"]] + [0, 20]
        )  # too far for a forearm to lean
        crossing = pose_to(landmarks(standing(azimuth), {"l_wrist": across}), RIG)
        assert joint(crossing, "l_wrist", "l_forearm")[2] == pytest.approx(depth * crossing.scale)


def test_a_limb_turns_from_its_parent_by_the_smallest_turn() -> None:
    """The trunk is twisted, an arm and a thigh are raised, elbow and knee are bent: none of them adds a twist."""
    true = standing()
    at = landmarks_of(true, RIG) * [1, -1, 1]
    middle = (at[INDEX["l_shoulder"]] + at[INDEX["r_shoulder"]]) / 2
    half = np.array([np.cos(0.7), 0, np.sin(0.7)]) * np.linalg.norm(at[INDEX["l_shoulder"]] - middle)
    moved = {"l_shoulder": middle + half, "r_shoulder": middle - half, "l_hip": at[INDEX["l_hip"]]}
    for start, end, direction in (
        ("l_shoulder", "l_elbow", (0.8, 0.4, 0.447)),
        ("l_elbow", "l_wrist", (-0.3, 0.6, 0.742)),
        ("l_hip", "l_knee", (0.5, -0.3, 0.812)),
        ("l_knee", "l_ankle", (-0.4, -0.9, -0.173)),
    ):
        moved[end] = moved[start] + np.array(direction) * np.linalg.norm(RIG.joints[end] - RIG.joints[start]) * SCALE
    found = pose_to(landmarks(true, {name: place * [1, -1, 1] for name, place in moved.items()}, depth=True), RIG)

    def turn_of(segment: str) -> np.ndarray:
        u, _, v = np.linalg.svd(found.transforms[NUMBER[segment], :, :3])
        return u @ v

    for segment, parent, start, end in (
        ("l_arm", "chest", "l_shoulder", "l_elbow"),
        ("l_forearm", "l_arm", "l_elbow", "l_wrist"),
        ("l_thigh", "pelvis", "l_hip", "l_knee"),
        ("l_shin", "l_thigh", "l_knee", "l_ankle"),
    ):
        relative = turn_of(segment) @ turn_of(parent).T
        axis = np.array(
            [relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]]
        )
        rest = RIG.joints[end] - RIG.joints[start]
        hanging = turn_of(parent) @ rest / np.linalg.norm(rest)
        assert np.linalg.norm(axis) > 0.3 and abs(axis @ hanging) < 0.02, segment


def test_widths_widen_across_a_limb_and_not_along_it() -> None:
    seen = landmarks(standing(), depth=True)
    plain, wide = pose_to(seen, RIG), pose_to(seen, RIG, {"l_thigh": 1.5, "pelvis": 1.2})
    sizes = [np.linalg.svd(posed.transforms[NUMBER["l_thigh"], :, :3], compute_uv=False) for posed in (plain, wide)]
    assert sizes[0] == pytest.approx([SCALE] * 3, rel=0.01) and sizes[1] == pytest.approx(
        [1.5 * SCALE] * 2 + [SCALE], rel=0.01
    )
    ratio = wide.transforms[NUMBER["pelvis"], :, :3] / plain.transforms[NUMBER["pelvis"], :, :3]
    assert np.diag(ratio) == pytest.approx([1.2, 1, 1.2])
    for name in ("l_hip", "l_knee"):
        assert joint(wide, name, "l_thigh") == pytest.approx(joint(plain, name, "l_thigh"), abs=0.5)


def test_hands_feet_and_head_turn_to_what_is_seen_of_them() -> None:
    true = standing()
    plain = pose_to(landmarks(true, depth=True), RIG)
    wrist, neck = joint(plain, "l_wrist", "l_forearm"), joint(plain, "neck", "chest")
    size = np.linalg.norm(RIG.joints["head"] + [0, 0.03, 0.02] - RIG.joints["neck"]) * SCALE
    ears = neck[:2] * [1, -1] + size * np.array([0.6, -0.8])
    moved = {"l_hand": wrist[:2] * [1, -1] + [12, 0], "l_heel": (100, 250, 0), "l_toe": (115, 250, 20)}
    moved |= {"l_ear": ears + np.array([3, 0]), "r_ear": ears - np.array([3, 0])}
    found = pose_to(landmarks(true, moved, depth=True), RIG)
    turned = lambda segment, axis: found.transforms[NUMBER[segment], :, :3] @ axis / SCALE
    along = RIG.joints["l_wrist"] - RIG.joints["l_elbow"]
    assert turned("l_hand", along / np.linalg.norm(along)) == pytest.approx([1, 0, 0], abs=0.01)
    assert turned("l_foot", FORWARD) == pytest.approx([0.6, 0, 0.8], abs=0.01)
    crown = turned("head", RIG.joints["head"] + [0, 0.03, 0.02] - RIG.joints["neck"]) * SCALE + neck
    assert crown[:2] * [1, -1] == pytest.approx(ears, abs=0.5)
    # Nobody says where the right hand and foot are: in line with the forearm, and ahead.
    for one, other in (("r_hand", "r_forearm"), ("r_foot", "pelvis")):
        a, b = (found.transforms[NUMBER[name], :, :3] for name in (one, other))
        assert a / np.linalg.norm(a) == pytest.approx(b / np.linalg.norm(b), abs=0.02)
