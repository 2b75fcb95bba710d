"""The card's sentences: what a manager reads, made by rule from the figures and how sure they are."""

from __future__ import annotations

from cloak_core.detectors.defended.table import split_defence
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.specs import without_folders
from cloak_core.studies.card.certainty import (
    AT_LEAST,
    HALF,
    MEASURED,
    NOT_MEASURED,
    kind,
    shown,
    state,
    strongest,
    whole,
    worded,
    worn_rows,
)
from cloak_core.studies.card.leaderboard import name_of
from cloak_core.studies.hardening.student import TRAINABLE
from cloak_core.studies.report.words import interval, percent

GOOD = 0.9
ALWAYS = (
    "Printed cloth before a real camera: clothes here are rendered, or laid on photographs by computation.",
    "Night, weather, blur, crowds, people behind things, children, seated or lying people.",
    "Attacks by other means than a garment's colours: shape, light, stickers on the lens, the network's own files.",
    "Tracking over many frames: a detector that misses a person in one picture may find them in the next.",
)


def headline(card: dict) -> str:
    """Say at most three sentences: how many hide in photographs, how many in renders, what one says of the other."""
    return " ".join([*(line["said"] for line in lines(card)), *filter(None, (relation(card),))])


def lines(card: dict) -> list[dict]:
    """Say how many people the strongest attack hides, at the detector's own threshold: photographs first, then renders.

    Each a sentence (`said`) with one number, which is also a tile (`tiles`).
    """
    found = []
    for photographed in (True, False):
        attack = strongest(card, photographed)
        if attack is None:
            continue
        sure = whole(card)
        row = attack.row | {"state": AT_LEAST if AT_LEAST in (state(attack.row), sure) else MEASURED}
        where = "In photographs" if photographed else "On rendered bodies"
        said = f"{where}, {attack.worn} hides {worded(attack.row, sure)} of people from {name_of(card)}."
        what = "of people in photographs hidden" if photographed else "of people hidden, rendered"
        found.append(_tile(what, row, "success_own", "down") | {"said": said})
    return found


def relation(card: dict) -> str:
    """Say what the strongest attack on rendered bodies is worth in photographs, by rule from its row there."""
    rendered = strongest(card, False)
    if rendered is None:
        nothing = f"Nothing attacked {name_of(card)} here: it gives no gradients, and there was no cloak to show it."
        return "" if worn_rows(card) else nothing
    if not card["white_box"]:
        return "Nobody attacked it who has the network."
    if not card.get("photographs"):
        return "Nobody in photographs was shown: renders alone say little of them."
    again = worn_rows(card).get(rendered.in_photographs)
    if again is None:
        return "In photographs nobody wore that cloak: its figure is one of renders alone."
    apart = again["ci95_own"][1] < rendered.row["ci95_own"][0]
    carries = "what hides on renders does not hide there" if apart else "within their intervals the two agree"
    bounds = interval(again["ci95_own"])
    return f"Worn in photographs, the same cloth hides {shown(again)} (95 % interval {bounds}): {carries}."


def advice(card: dict) -> str:
    """Say what to do, by rule: first mend what is bad without an attack, then what a sure attack does."""
    clean = card["clean"]
    if clean["recall_own"] < GOOD or clean["false_alarms_own"] > 1 - GOOD:
        return "First make it better without any attack: it misses people, or sees them where nobody is, too often."
    if kind(card) == "bad":
        hardening = f", harden it ({command})" if (command := harden_command(card["spec"])) else ""
        return (
            "Do not let it decide alone where somebody may want to hide: put a second sensor or an unlike detector "
            f"beside it{hardening}, and make this card again."
        )
    if not card["white_box"]:
        return "Ask whoever has the network for the white-box part of this card before you rely on it."
    if whole(card) == AT_LEAST:
        why = card["partial_gradient"] and "they follow a part of its gradient alone"
        return f"Do not take these figures for its limit: its attacks were short of the protocol{why and f', {why}'}."
    if kind(card) == "unknown":
        return "Put a second sensor beside it where much depends on it: the intervals of its attacks reach half."
    longer = " Make a card of a larger size, too (cloak assess --size full)." if card["size"] != "full" else ""
    return f"Keep it so: hold every new version against bounds on these figures (cloak assess --gate).{longer}"


def harden_command(spec: str) -> str:
    """Give the command that hardens this detector; "" where its family cannot be."""
    if split_defence(spec) is not None or parse_spec(spec).family not in TRAINABLE:
        return ""
    return f"cloak harden {without_folders(spec)}"


def verdict(card: dict) -> tuple[str, str]:
    """Judge the card: kind (good, bad, unknown) and words of the badge."""
    judged = kind(card)
    if judged == "bad":
        hiding = [row["asked"] for row in card["white_box"] if row["success_own"] >= HALF]
        if hiding:
            return judged, f"hidden by {percent(min(hiding))} of the body"
        return judged, f"hidden by {strongest(card).worn.rstrip(',')}"
    if not card["white_box"]:
        return judged, "white box not measured"
    if whole(card) == AT_LEAST:
        return judged, "white box short of the protocol"
    return judged, "no attack hid half"


def tiles(card: dict) -> list[dict]:
    """List the large figures: what, value, interval, state, and whether that is good for whoever runs the detector."""
    clean, black, rows = card["clean"], card["black_box"], card["white_box"]
    ends = [rows[k] for k in sorted({0, len(rows) - 1})] if rows else []
    listed = [_tile("finds people in own clothing", clean, "recall_own", "up")]
    listed += [_tile(f"hidden by {percent(row['area'])} of the body", row, "success_own", "down") for row in ends]
    listed += [] if rows else [_tile("hidden by a cloak made against it", None, "success_own", "down")]
    listed.append(_tile("hidden all around", card.get("around"), "success_own", "down"))
    strange = next((row for row in black["zoo"] if row["name"] == black["worst"]), None)
    listed.append(_tile("hidden by others' cloaks", strange, "success_own", "down"))
    listed.append(_tile("false alarms on bare scenes", clean, "false_alarms_own", "down"))
    return listed


def _tile(what: str, row: dict | None, key: str, good: str) -> dict:
    """Make a tile: green only of what was measured; what was not measured has no number."""
    if state(row) == NOT_MEASURED:
        return {"what": f"{what}: not measured", "value": "–", "interval": "–", "kind": "unknown", "state": state(row)}
    better = row[key] if good == "up" else 1 - row[key]
    judged = "good" if better >= GOOD and state(row) == MEASURED else "bad" if better < HALF else "unknown"
    bounds = row.get("ci95_" + key, row.get("ci95_own"))
    steps = f" ({row['steps']:,} updates)" if state(row) == AT_LEAST and "steps" in row else ""
    return {
        "what": what + steps,
        "value": shown(row, key),
        "interval": interval(bounds),
        "kind": judged,
        "state": state(row),
    }


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
    said = list(card["not_tested"])
    if card["white_box"]:
        steps = card["white_box"][-1]["steps"]
        around = f" ({card['around']['steps']} for the full circle)" if card.get("around") else ""
        once = "" if card["counts"]["seeds"] > 1 else ", once"
        said.append(
            f"Longer attacks: the largest cloak had {steps} updates{around} from one start{once}. "
            "An attacker with more time does as well or better."
        )
    return said + list(ALWAYS)
