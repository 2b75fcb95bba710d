"""The card's sentences: what a manager reads, made by rule from the figures."""

from __future__ import annotations

from cloak_core.studies.card.leaderboard import at_least, is_too_short, name_of, worn_rows
from cloak_core.studies.card.protocol import AGAINST
from cloak_core.studies.report.words import instead, interval, percent

HALF, GOOD = 0.5, 0.9
ALWAYS = (
    "Printed cloth before a real camera: clothes here are rendered, or laid on photographs by computation.",
    "Night, weather, blur, crowds, people behind things, children, seated or lying people.",
    "Attacks by other means than a garment's colours: shape, light, stickers on the lens, the network's own files.",
    "Tracking over many frames: a detector that misses a person in one picture may find them in the next.",
)


def headline(card: dict) -> str:
    """Say how well people hide and what is seen instead, at the detector's own threshold; photographs first."""
    name, rows, black = name_of(card), card["white_box"], card["black_box"]
    photographs = worn_rows(card)
    if photographs:
        worn, row = max(photographs.items(), key=lambda pair: pair[1]["success_own"])
        own = percent(card["photographs"]["rows"]["clothing"]["success_own"])
        hidden = f"{'at least ' if _is_unsure(card) else ''}{percent(row['success_own'])}"
        return (
            f"In photographs, {hidden} of people who wear {_worn(worn)} are hidden from {name}"
            f"{instead(row, own=True)}; in their own clothing it misses {own} of them."
        )
    if not rows and black["counted"]:
        return f"Cloaks made against other detectors hide up to {percent(black['success_own'])} of people from {name}."
    if not rows:
        return f"Nothing attacked {name} here: it gives no gradients, and there was no cloak to show it."
    half = next((row for row in rows if row["success_own"] >= HALF), None)
    row = half or max(rows, key=lambda row: row["success_own"])
    what, hidden = f"on {percent(row['area'])} of the body", percent(row["success_own"])
    rest = f"{instead(row, own=True)}. In their own clothing it misses {percent(row['clothing_own'])} of the same."
    if half is None:
        return f"No cloak that was tried hid half of the people from {name}: the best, {what}, hid {hidden}{rest}"
    return f"A cloak {what}, made against {name}, hides {hidden} of people from it{rest}"


def _is_unsure(card: dict) -> bool:
    """Whether any cloak made against it had too little time to say how well people hide."""
    return any(is_too_short(card, row) for row in card["white_box"])


def _worn(name: str) -> str:
    return "a cloak made against it" if name == AGAINST else f"the pattern {name.partition('@')[0]}"


def worst(card: dict) -> dict:
    """Find the one number: the largest share of people hidden at the own threshold, as a tile with its words.

    Of people in photographs where there are any; else of renders: white box, all around, patterns, others' cloaks.
    """
    found = [("of people in photographs hidden", row) for row in worn_rows(card).values()]
    if not found:
        found = [("of people hidden, rendered", row) for row in (*card["white_box"], *card.get("patterns", []))]
        found += [("of people hidden, rendered", card["around"])] if card.get("around") else []
        found += [
            ("of people hidden, rendered", row) for row in card["black_box"]["zoo"] if not row["trained_against_it"]
        ]
    if not found:
        return {"what": "nothing attacked it", "value": "–", "interval": "–", "kind": "unknown"}
    what, row = max(found, key=lambda pair: pair[1]["success_own"])
    tile = _tile(what, row, "success_own", "down")
    if _is_unsure(card) and tile["kind"] == "good":
        tile |= {"value": f"≥ {tile['value']}", "kind": "unknown"}
    return tile


def advice(card: dict) -> str:
    """Say what to do, by rule: first mend what is bad without an attack, then what an attack does."""
    clean, worse = card["clean"], worst(card)["kind"]
    if clean["recall_own"] < GOOD or clean["false_alarms_own"] > 1 - GOOD:
        return "First make it better without any attack: it misses people, or sees them where nobody is, too often."
    if worse == "unknown" and not card["white_box"]:
        return "Ask whoever has the network for the white-box part of this card before you rely on it."
    if worse == "bad":
        return (
            "Do not let it decide alone where somebody may want to hide: put a second sensor or an unlike detector "
            "beside it, harden it (cloak harden), and make this card again."
        )
    if _is_unsure(card):
        return "Give this card more time (--minutes): its attacks were too short to say how well people can hide."
    if worse == "unknown":
        return "Put a second sensor beside it where much depends on it, harden it (cloak harden), make this card again."
    return "Keep it so: hold every new version against bounds on these figures (cloak assess --gate)."


def verdict(card: dict) -> tuple[str, str]:
    """Judge by the least area that hides half of the people: kind (good, bad, unknown) and words of the badge.

    unknown: there was no attack, it was too short, or the intervals reach beyond half.
    """
    rows = card["white_box"]
    if not rows:
        return "unknown", "white box not tested"
    hiding = [row["asked"] for row in rows if row["success_own"] >= HALF]
    if hiding:
        return "bad", f"hidden by {percent(min(hiding))} of the body"
    if _is_unsure(card):
        return "unknown", "white box too short to say"
    sure = all(row["ci95_own"][1] < HALF for row in rows)
    return "good" if sure else "unknown", "no cloak hid half"


def tiles(card: dict) -> list[dict]:
    """List the large figures: what, value, interval, and whether that is good for whoever runs the detector."""
    clean, black, rows = card["clean"], card["black_box"], card["white_box"]
    ends = [rows[k] for k in sorted({0, len(rows) - 1})] if rows else []
    found = [_tile("finds people in own clothing", clean, "recall_own", "up")]
    attacks = [(f"hidden by {percent(row['area'])} of the body", row) for row in ends]
    attacks += [("hidden all around", card["around"])] if card.get("around") else []
    for what, row in attacks:
        tile, mark = _tile(what, row, "success_own", "down"), at_least(card, row)
        unsure = {"what": f"{what} ({row['steps']} updates)", "value": mark + tile["value"]} if mark else {}
        found.append(tile | unsure | ({"kind": "unknown"} if mark and tile["kind"] == "good" else {}))
    if black["counted"]:
        worst = next(row for row in black["zoo"] if row["name"] == black["worst"])
        found.append(_tile("hidden by others' cloaks", worst, "success_own", "down"))
    found.append(_tile("false alarms on bare scenes", clean, "false_alarms_own", "down"))
    return found


def _tile(what: str, row: dict, key: str, good: str) -> dict:
    value, bounds = row[key], row.get("ci95_" + key, row.get("ci95_own"))
    better = value if good == "up" else 1 - value
    kind = "good" if better >= GOOD else "bad" if better < HALF else "unknown"
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


def untested_here(card: dict) -> list[str]:
    """Say what this card cannot tell for reasons of this detector or this call; kept in the card."""
    said = []
    if not card["differentiable"]:
        said.append(
            "No white-box attack: the detector gives no gradients. An attacker who has its weights in another "
            "form may do far better than the cloaks shown here."
        )
    elif card["partial_gradient"]:
        said.append(f"The gradient that the attack follows is not all of the answer's: {card['partial_gradient']}.")
    if not card["black_box"]["counted"]:
        some = bool(card["black_box"]["zoo"])
        why = "those there are were made against it" if some else "the zoo holds none for this scene's bodies"
        said.append(f"No cloak made against other detectors: {why}.")
    return said


def not_tested(card: dict) -> list[str]:
    """List everything a reader must not take for tested: this card's own, then what no card tests."""
    said = list(card["not_tested"])
    if card["white_box"]:
        steps = card["white_box"][-1]["steps"]
        around = f" ({card['around']['steps']} for the full circle)" if card.get("around") else ""
        once = "" if card["counts"]["seeds"] > 1 else ", once"
        said.append(
            f"Longer attacks: the largest cloak had {steps} updates{around} from one start{once}. "
            "An attacker with more time does as well or better."
        )
    dropped = [part for part, share in card.get("shares", {}).items() if not share]
    if dropped:
        names = ", ".join("the full circle" if part == "circle" else part for part in dropped)
        said.append(f"{names}: not attacked, so that the cloaks that were made got more of the time (--minutes).")
    short = {part: share for part, share in card.get("shares", {}).items() if 0 < share < 1}
    if short:
        least = min(short.values())
        said.append(
            f"{card['counts']['minutes']:g} minutes were not enough for everything: {len(short)} parts had fewer steps "
            f"and images, down to {percent(least)} of them. Their intervals are wider, and their attacks weaker."
        )
    if not card.get("photographs"):
        said.append("People in photographs: none were given (--people).")
    return said + list(ALWAYS)
