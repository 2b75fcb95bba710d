"""How sure a card's figures are, and its sentences: made by rule, the same for page, terminal, gate and leaderboard.

A figure is "measured"; or "at least" as much, where the attack behind it was shorter than the protocol asks for or
followed a part of the gradient alone; or "not measured".
"""

from __future__ import annotations

from collections.abc import Sequence

from cloak_core.detectors.defended.table import split_defence
from cloak_core.detectors.specs import parse_spec
from cloak_core.files.specs import without_folders
from cloak_core.studies.card.protocol import AGAINST, AT_LEAST, GREY_HEAD, HEADS, MEASURED, UNTRAINED
from cloak_core.studies.hardening.student import TRAINABLE
from cloak_core.studies.report.words import interval, percent, short_name
from cloak_core.zoo.entry import MARK

NOT_MEASURED = "not measured"
GOOD, HALF = 0.9, 0.5
ALWAYS = (
    "Printed cloth before a real camera: clothes here are rendered, or laid on photographs by computation.",
    "Night, weather, blur, crowds, people behind things, children, seated or lying people.",
    "Attacks by other means than a garment's colours: shape, light, stickers on the lens, the network's own files.",
    "Tracking over many frames: a detector that misses a person in one picture may find them in the next.",
)


def name_of(card: dict) -> str:
    """Give the detector's name, as pages call it."""
    return card.get("label") or short_name(card["spec"])


# --- how sure


def state(row: dict | None) -> str:
    """Tell how sure a row of a card is; one that is not there was not measured."""
    return NOT_MEASURED if not row else row["state"]


def shown(row: dict | None, key: str = "success_own") -> str:
    """Write a share for tiles and tables: "55 %", "≥ 55 %", or "–" where it was not measured."""
    if state(row) == NOT_MEASURED:
        return "–"
    return f"{'≥ ' if state(row) == AT_LEAST else ''}{percent(row[key])}"


def whole(card: dict) -> str:
    """Tell how sure a card is of the strongest attack: at most "at least" without a white box that was measured."""
    sure = bool(card["white_box"]) and all(state(row) == MEASURED for row in card["white_box"])
    return MEASURED if sure else AT_LEAST if attacks(card) else NOT_MEASURED


def attacks(card: dict) -> list[dict]:
    """List the row of every attack of a card, on people in photographs first, then on rendered bodies.

    Each row also says what was `worn`, in words, whether by people in photographs (`photographed`), and for rendered
    bodies what people in photographs call the same cloth (`again`, "" where they never wear it).
    """
    listed = []

    def add(worn: str, row: dict, again: str = "", photographed: bool = False) -> None:
        listed.append(row | {"worn": worn, "again": again, "photographed": photographed})

    for name, row in worn_rows(card).items():
        pattern, _, is_pattern = name.partition("@")
        strange = f"the pattern {pattern}" if is_pattern else f"{name}, made against other detectors,"
        add("a cloak made against it" if name == AGAINST else strange, row, photographed=True)
    for row in card["white_box"]:
        largest = AGAINST if row is card["white_box"][-1] else ""
        add(f"a cloak on {percent(row['area'])} of the body, made against it,", row, largest)
    if card.get("around"):
        add("a cloak for all sides, made against it,", card["around"])
    for row in card.get("patterns") or []:
        add(f"the pattern {row['name'].partition('@')[0]}", row, row["name"])
    for row in card["black_box"]["zoo"]:
        if not row["trained_against_it"]:
            add(f"{row['name']}, made against other detectors,", row, MARK + row["name"])
    return listed


def strongest(card: dict, photographed: bool | None = None) -> dict | None:
    """Find the attack that hides most people at the detector's own threshold; of equal ones, the photographs'."""
    chosen = [row for row in attacks(card) if photographed in (None, row["photographed"])]
    return max(chosen, key=lambda row: row["success_own"], default=None)


def worn_rows(card: dict) -> dict[str, dict]:
    """Select what people in photographs wore, faces and hair free, beside the controls: name -> S."""
    rows = (card.get("photographs") or {}).get("rows", {})
    return {name: row for name, row in rows.items() if name not in (*UNTRAINED, *HEADS, GREY_HEAD)}


def others_strongest(zoo: Sequence[dict]) -> dict | None:
    """Choose the cloak made against other detectors that hides most people, at the own threshold and then at 0.6."""
    counted = [row for row in zoo if not row["trained_against_it"]]
    return max(counted, key=lambda row: (row["success_own"], row["success"]), default=None)


# --- sentences


def headline(card: dict) -> str:
    """Say at most three sentences: how many hide in photographs, how many in renders, what one says of the other."""
    return " ".join(filter(None, (*(line["said"] for line in lines(card)), relation(card))))


def lines(card: dict) -> list[dict]:
    """Say how many people the strongest attack hides, at the detector's own threshold: photographs first, then renders.

    Each a sentence (`said`) with one number, which is also a tile (`tiles`).
    """
    rows = []
    for photographed in (True, False):
        attack = strongest(card, photographed)
        if attack is None:
            continue
        row = attack | {"state": AT_LEAST if AT_LEAST in (attack["state"], whole(card)) else MEASURED}
        where = "In photographs" if photographed else "On rendered bodies"
        share = shown(row).replace("≥", "at least")
        sentence = f"{where}, {attack['worn']} hides {share} of people from {name_of(card)}."
        what = "of people in photographs hidden" if photographed else "of people hidden, rendered"
        rows.append(_tile(what, row) | {"said": sentence})
    return rows


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
    again = worn_rows(card).get(rendered["again"])
    if again is None:
        return "In photographs nobody wore that cloak: its figure is one of renders alone."
    apart = again["ci95_own"][1] < rendered["ci95_own"][0]
    carries = "what hides on renders does not hide there" if apart else "within their intervals the two agree"
    bounds = interval(again["ci95_own"])
    return f"Worn in photographs, the same cloth hides {shown(again)} (95 % interval {bounds}): {carries}."


def judge(card: dict) -> tuple[str, str, str]:
    """Judge a card for whoever runs the detector: kind, words of its badge, and what to do.

    bad: an attack hides half of the people or more. good: the white box was measured, and no interval of any attack
    reaches half. unknown: else. To be done first is what is bad without any attack.
    """
    clean, rows, most = card["clean"], card["white_box"], strongest(card)
    if most is not None and most["success_own"] >= HALF:
        hiding = [row["asked"] for row in rows if row["success_own"] >= HALF]
        by = f"{percent(min(hiding))} of the body" if hiding else most["worn"].rstrip(",")
        can_be_hardened = split_defence(card["spec"]) is None and parse_spec(card["spec"]).family in TRAINABLE
        hardening = f", harden it (cloak harden {without_folders(card['spec'])})" if can_be_hardened else ""
        kind, badge = "bad", f"hidden by {by}"
        advice = (
            "Do not let it decide alone where somebody may want to hide: put a second sensor or an unlike detector "
            f"beside it{hardening}, and make this card again."
        )
    elif not rows:
        kind, badge = "unknown", "white box not measured"
        advice = "Ask whoever has the network for the white-box part of this card before you rely on it."
    elif whole(card) == AT_LEAST:
        kind, badge = "unknown", "white box short of the protocol"
        why = ", they follow a part of its gradient alone" if card["partial_gradient"] else ""
        advice = f"Do not take these figures for its limit: its attacks were short of the protocol{why}."
    elif any(row["ci95_own"][1] >= HALF for row in attacks(card)):
        kind, badge = "unknown", "no attack hid half"
        advice = "Put a second sensor beside it where much depends on it: the intervals of its attacks reach half."
    else:
        kind, badge = "good", "no attack hid half"
        longer = " Make a card of a larger size, too (cloak assess --size full)." if card["size"] != "full" else ""
        advice = f"Keep it so: hold every new version against bounds on these figures (cloak assess --gate).{longer}"
    if clean["recall_own"] < GOOD or clean["false_alarms_own"] > 1 - GOOD:
        advice = "First make it better without any attack: it misses people, or sees them where nobody is, too often."
    return kind, badge, advice


def tiles(card: dict) -> list[dict]:
    """List the large figures: what, value, interval, state, and whether that is good for whoever runs the detector."""
    clean, rows = card["clean"], card["white_box"]
    listed = [_tile("finds people in own clothing", clean, "recall_own")]
    listed += [_tile(f"hidden by {percent(row['area'])} of the body", row) for row in (*rows[:1], *rows[1:][-1:])]
    listed += [] if rows else [_tile("hidden by a cloak made against it", None)]
    listed.append(_tile("hidden all around", card.get("around")))
    listed.append(_tile("hidden by others' cloaks", others_strongest(card["black_box"]["zoo"])))
    listed.append(_tile("false alarms on bare scenes", clean, "false_alarms_own"))
    return listed


def _tile(what: str, row: dict | None, key: str = "success_own") -> dict:
    """Make a tile: green only of what was measured; what was not measured has no number."""
    sure = state(row)
    if sure == NOT_MEASURED:
        return {"what": f"{what}: not measured", "value": "–", "interval": "–", "kind": "unknown", "state": sure}
    better = row[key] if key == "recall_own" else 1 - row[key]
    steps = f" ({row['steps']:,} updates)" if sure == AT_LEAST and "steps" in row else ""
    return {
        "what": what + steps,
        "value": shown(row, key),
        "interval": interval(row.get("ci95_" + key, row.get("ci95_own"))),
        "kind": "good" if better >= GOOD and sure == MEASURED else "bad" if better < HALF else "unknown",
        "state": sure,
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
    sentences = list(card["not_tested"])
    if card["white_box"]:
        steps = card["white_box"][-1]["steps"]
        around = f" ({card['around']['steps']} for the full circle)" if card.get("around") else ""
        once = "" if card["counts"]["seeds"] > 1 else ", once"
        sentences.append(
            f"Longer attacks: the largest cloak had {steps} updates{around} from one start{once}. "
            "An attacker with more time does as well or better."
        )
    return sentences + list(ALWAYS)
