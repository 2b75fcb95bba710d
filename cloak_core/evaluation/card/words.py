"""The card's sentences: what a manager reads, made by rule from the figures."""

from __future__ import annotations

from cloak_core.evaluation.card.leaderboard import name_of
from cloak_core.evaluation.report.words import interval, percent

HALF = 0.5
ALWAYS = (
    "Printed cloth before a real camera: everything here is rendered, with one simple light.",
    "Night, weather, blur, crowds, people behind things, children, seated or lying people.",
    "Attacks by other means than a garment's colours: shape, light, stickers on the lens, the network's own files.",
    "Tracking over many frames: a detector that misses a person in one picture may find them in the next.",
)


def headline(card: dict) -> str:
    """Say in one sentence how little a cloak needs, at the threshold at which the detector is run."""
    name, rows, black = name_of(card), card["white_box"], card["black_box"]
    if not rows and black["counted"]:
        return f"Cloaks made against other detectors hide up to {percent(black['success_own'])} of people from {name}."
    if not rows:
        return f"Nothing attacked {name} here: it gives no gradients, and there was no cloak to show it."
    half = next((row for row in rows if row["success_own"] >= HALF), None)
    row = half or max(rows, key=lambda row: row["success_own"])
    what, hidden = f"on {percent(row['area'])} of the body", percent(row["success_own"])
    own = f"In their own clothing it misses {percent(row['clothing_own'])} of the same."
    if half is None:
        return f"No cloak that was tried hid half of the people from {name}: the best, {what}, hid {hidden}. {own}"
    return f"A cloak {what}, made against {name}, hides {hidden} of people from it. {own}"


def verdict(card: dict) -> tuple[str, str]:
    """Judge by the least area that hides half of the people: kind (good, bad, unknown) and words of the badge.

    unknown: there was no attack, or the intervals reach beyond half.
    """
    rows = card["white_box"]
    if not rows:
        return "unknown", "white box not tested"
    hiding = [row["asked"] for row in rows if row["success_own"] >= HALF]
    if hiding:
        return "bad", f"hidden by {percent(min(hiding))} of the body"
    sure = all(row["ci95_own"][1] < HALF for row in rows)
    return "good" if sure else "unknown", "no cloak hid half"


def tiles(card: dict) -> list[dict]:
    """List the large figures: what, value, interval, and whether that is good for whoever runs the detector."""
    clean, black, rows = card["clean"], card["black_box"], card["white_box"]
    ends = [rows[k] for k in sorted({0, len(rows) - 1})] if rows else []
    found = [_tile("finds people in own clothing", clean, "recall_own", "up")]
    found += [_tile(f"hidden by {percent(row['area'])} of the body", row, "success_own", "down") for row in ends]
    if card.get("around"):
        found.append(_tile("hidden all around", card["around"], "success_own", "down"))
    if black["counted"]:
        worst = next(row for row in black["zoo"] if row["name"] == black["worst"])
        found.append(_tile("hidden by others' cloaks", worst, "success_own", "down"))
    found.append(_tile("false alarms on bare scenes", clean, "false_alarms_own", "down"))
    return found


def _tile(what: str, row: dict, key: str, good: str) -> dict:
    value, bounds = row[key], row.get("ci95_" + key, row.get("ci95_own"))
    better = value if good == "up" else 1 - value
    kind = "good" if better >= 0.9 else "bad" if better < HALF else "unknown"
    return {"what": what, "value": percent(value), "interval": interval(bounds), "kind": kind}


def lede(card: dict) -> str:
    """Describe the detector without any attack: what stands under the headline."""
    clean = card["clean"]
    return (
        f"Without a cloak it finds {percent(clean['recall_own'])} of people at its own threshold of "
        f"{card['operating_point']:g}{' (assumed)' if card['operating_point_assumed'] else ''} "
        f"(95 % interval {interval(clean['ci95_own'])}, {clean['n']:,} images), person AP50 "
        f"{100 * clean['ap50']:.1f} and AP50:95 {100 * clean['ap50_95']:.1f}; it sees somebody in "
        f"{percent(clean['false_alarms_own'])} of {clean['backgrounds']} empty scenes."
    )


def not_tested(card: dict) -> list[str]:
    """List everything a reader must not take for tested: this card's own, then what no card tests."""
    steps, said = card["counts"]["steps"], list(card["not_tested"])
    if card["white_box"]:
        once = "" if card["counts"]["seeds"] > 1 else ", once"
        said.append(
            f"Longer attacks: each cloak had {steps} updates ({2 * steps} for the full circle) from one start{once}. "
            "An attacker with more time does as well or better."
        )
    return said + list(ALWAYS)
