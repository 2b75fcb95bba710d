"""The card's sentences: what a manager reads, made by rule from the figures."""

from __future__ import annotations

from collections.abc import Sequence

from cloak_core.evaluation.report.words import interval, percent, short_name

HALF = 0.5
ALWAYS = (
    "Printed cloth before a real camera: everything here is rendered, with one simple light.",
    "Night, weather, blur, crowds, people behind things, children, seated or lying people.",
    "Attacks by other means than a garment's colours: shape, light, stickers on the lens, the network's own files.",
    "Tracking over many frames: a detector that misses a person in one picture may find them in the next.",
)


def name_of(card: dict) -> str:
    """The detector's name, as the page calls it."""
    return card.get("label") or short_name(card["spec"])


def headline(card: dict) -> str:
    """One sentence: how little a cloak needs, at the threshold at which the detector is run."""
    name = name_of(card)
    rows = card["white_box"]
    if not rows:
        black = card["black_box"]
        if black["counted"]:
            return (
                f"Cloaks made against other detectors hide up to {percent(black['success_own'])} of people from {name}."
            )
        return f"Nothing attacked {name} here: it gives no gradients, and there was no cloak to show it."
    half = next((row for row in rows if row["success_own"] >= HALF), None)
    row = half or max(rows, key=lambda row: row["success_own"])
    what = f"on {percent(row['area'])} of the body"
    own = f"In their own clothing it misses {percent(row['clothing_own'])} of the same."
    if half is None:
        least = f"No cloak that was tried hid half of the people from {name}: the best, {what}, hid"
        return f"{least} {percent(row['success_own'])}. {own}"
    return f"A cloak {what}, made against {name}, hides {percent(row['success_own'])} of people from it. {own}"


def verdict(card: dict) -> tuple[str, str]:
    """(kind, words) of the badge, by the least area that hides half of the people: good, bad, or unknown where there
    was no attack or the intervals reach beyond half."""
    rows = card["white_box"]
    if not rows:
        return "unknown", "white box not tested"
    hiding = [row["asked"] for row in rows if row["success_own"] >= HALF]
    if hiding:
        return "bad", f"hidden by {percent(min(hiding))} of the body"
    sure = all(row["ci95_own"][1] < HALF for row in rows)
    return "good" if sure else "unknown", "no cloak hid half"


def tiles(card: dict) -> list[dict]:
    """The large figures: what, value, interval, and whether low or high is good for whoever runs the detector."""
    clean, black = card["clean"], card["black_box"]
    rows = card["white_box"]
    found = [_tile("finds people in own clothing", clean, "recall_own", "up")]
    found += [
        _tile(f"hidden by {percent(rows[k]['area'])} of the body", rows[k], "success_own", "down") for k in _ends(rows)
    ]
    if card.get("around"):
        found.append(_tile("hidden all around", card["around"], "success_own", "down"))
    if black["counted"]:
        worst = next(row for row in black["zoo"] if row["name"] == black["worst"])
        found.append(_tile("hidden by others' cloaks", worst, "success_own", "down"))
    found.append(_tile("false alarms on bare scenes", clean, "false_alarms_own", "down"))
    return found


def _ends(rows: Sequence[dict]) -> list[int]:
    """The smallest and the largest area."""
    return sorted({0, len(rows) - 1}) if rows else []


def _tile(what: str, row: dict, key: str, good: str) -> dict:
    value, bounds = row[key], row.get("ci95_" + key, row.get("ci95_own"))
    better = value if good == "up" else 1 - value
    kind = "good" if better >= 0.9 else "bad" if better < HALF else "unknown"
    return {"what": what, "value": percent(value), "interval": interval(bounds), "kind": kind}


def lede(card: dict) -> str:
    """What stands under the headline: the detector without any attack."""
    clean = card["clean"]
    return (
        f"Without a cloak it finds {percent(clean['recall_own'])} of people at its own threshold of "
        f"{card['operating_point']:g}{' (assumed)' if card['operating_point_assumed'] else ''} "
        f"(95 % interval {interval(clean['ci95_own'])}, {clean['n']:,} images), person AP50 "
        f"{100 * clean['ap50']:.1f} and AP50:95 {100 * clean['ap50_95']:.1f}; it sees somebody in "
        f"{percent(clean['false_alarms_own'])} of {clean['backgrounds']} empty scenes."
    )


def not_tested(card: dict) -> list[str]:
    """Everything a reader must not take for tested: this card's own, then what no card tests."""
    steps = card["counts"]["steps"]
    said = list(card["not_tested"])
    if card["white_box"]:
        said.append(
            f"Longer attacks: each cloak had {steps} updates ({2 * steps} for the full circle) from one start"
            f"{'' if card['counts']['seeds'] > 1 else ', once'}. An attacker with more time does as well or better."
        )
    return said + list(ALWAYS)


def leaderboard_row(card: dict) -> dict[str, str]:
    """The card's line in a leaderboard, column by column."""
    clean, rows, black = card["clean"], card["white_box"], card["black_box"]
    by_area = {f"hidden, {percent(row['asked'])}": _both(row, "success_own", "ci95_own") for row in rows}
    around = _both(card["around"], "success_own", "ci95_own") if card.get("around") else "–"
    return {
        "detector": name_of(card),
        "protocol": f"{card['protocol']}, {card['budget']}",
        "threshold": f"{card['operating_point']:g}",
        "clean recall": _both(clean, "recall_own", "ci95_own"),
        "AP50": f"{100 * clean['ap50']:.1f}",
        "AP50:95": f"{100 * clean['ap50_95']:.1f}",
        "false alarms": percent(clean["false_alarms_own"]),
        **by_area,
        "mASR": percent(rows[-1]["masr"]) if rows else "–",
        "all around": around,
        "others' cloaks": percent(black["success_own"]) if black["counted"] else "–",
    }


def _both(row: dict, key: str, bounds: str) -> str:
    return f"{percent(row[key])} ({interval(row[bounds])})"
