"""Before and after hardening: what the words make of the rows."""

from cloak_core.evaluation.experiments.hardened import ADAPTIVE, CHEST, SEARCH, SHIRT, TRANSFERRED, draw, tell
from cloak_core.evaluation.experiments.numbers import Numbers


def row(attack: str, success: float, steps: int = 400, logo: str = CHEST, made_on: str = "builtin") -> dict:
    interval = {"low": success - 0.05, "high": success + 0.05, "n": 330, "success_own": success}
    clean = {
        "clean_recall": 0.98,
        "clean_recall_own": 0.99,
        "clean_ap50": 0.9,
        "false_alarms": 0.01,
        "false_alarms_own": 0.02,
    }
    label = {"detector": "builtin", "logo": logo, "attack": attack, "trained_on": made_on, "steps": steps}
    return label | {"success": success} | interval | clean


def numbers(short: float, searched: float) -> Numbers:
    rows = [row(ADAPTIVE, 0.25), row(ADAPTIVE, 0.4, logo=SHIRT), row(ADAPTIVE, short, steps=100)]
    rows += [row(TRANSFERRED, 0.1, made_on="darknet:/a/b.cfg:/a/b.weights"), row(SEARCH, searched)]
    return Numbers(rows, {"angles": 11})


def test_words_give_the_longest_attack_and_the_curve_in_order_of_its_length() -> None:
    words = tell(numbers(0.12, 0.05))[1]
    assert "on chest + thighs 25 %" in words and "on shirt + trousers 40 %" in words
    assert "steps: 12 % (100), 25 % (400)." in words
    assert "transferred from darknet b, 400 steps: 10 %" in words
    assert "too kind" not in words


def test_words_say_where_less_does_more() -> None:
    assert "strongest is random search" in tell(numbers(0.12, 0.6))[1]
    assert "strongest is adaptive, 100 steps" in tell(numbers(0.6, 0.05))[1]


def test_several_hardened_ones_are_told_apart_and_their_trade_is_drawn() -> None:
    specs = ["builtin", "builtin:/a/weak/hardened.weights", "builtin:/a/strong/hardened.weights"]
    rows = [
        row(ADAPTIVE, success, logo=logo) | {"detector": spec, "trained_on": spec, "clean_recall": recall}
        for spec, success, recall in zip(specs, (0.9, 0.4, 0.1), (0.99, 0.98, 0.9), strict=True)
        for logo in (CHEST, SHIRT)[: 1 if spec == "builtin" else 2]
    ]
    found = Numbers(rows, {"angles": 11})
    assert [words.partition(":")[0] for words in tell(found)[1:]] == [
        "builtin",
        "builtin hardened (weak)",
        "builtin hardened (strong)",
    ]
    recalls, alarms = draw(found)["trade"].axes
    points = [(bar.lines[0].get_xdata()[0], bar.lines[0].get_ydata()[0]) for bar in recalls.containers]
    assert points == [(0.99, 0.9), (0.98, 0.4), (0.98, 0.4), (0.9, 0.1), (0.9, 0.1)]
    assert all(bar.lines[0].get_xdata()[0] == 0.01 for bar in alarms.containers)


def test_the_figure_has_the_curve_and_the_search() -> None:
    (figure,) = draw(numbers(0.12, 0.05)).values()
    assert [list(line.get_xdata()) for line in figure.axes[0].get_lines()] == [[100, 400], [400]]
