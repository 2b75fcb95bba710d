"""The table of defences: what the words make of its rows."""

from cloak_core.evaluation.experiments.defences import ADAPTIVE, NAIVE, NONE, SEARCH, draw, tell
from cloak_core.evaluation.experiments.numbers import Numbers


def row(defence: str, attack: str, success: float) -> dict:
    interval = {"low": success - 0.05, "high": success + 0.05, "n": 84}
    clean = {"clean_recall": 0.99, "clean_ap50": 0.9 if defence == NONE else 0.8}
    return {"detector": "builtin", "defence": defence, "attack": attack, "success": success} | interval | clean


def numbers(searched: float) -> Numbers:
    rows = [row(NONE, NAIVE, 0.95), row(NONE, ADAPTIVE, 0.95), row(NONE, SEARCH, 0.2)]
    rows += [row("jpeg=75", NAIVE, 0.3), row("jpeg=75", ADAPTIVE, 0.7), row("jpeg=75", SEARCH, searched)]
    return Numbers(rows, {"steps": {"builtin": 150}, "angles": 11})


def test_words_set_the_adaptive_attack_beside_the_naive_one_and_say_the_cost() -> None:
    words = tell(numbers(0.1))[2]
    assert words.startswith("jpeg=75: 30 % when naive, 70 % (95 % interval")
    assert "random search 10 %" in words
    assert "clean AP50 0.800 instead of 0.900" in words
    assert "too kind" not in words


def test_words_say_where_the_gradient_is_masked() -> None:
    assert "The strongest is random search" in tell(numbers(0.9))[2]
    assert "too kind" not in tell(numbers(0.74))[2]  # within the interval


def test_words_blame_no_defence_for_an_attack_that_is_too_short() -> None:
    weak = numbers(0.9)
    for one in weak.rows:
        one |= {} if one["attack"] == SEARCH else {"success": 0.02, "low": 0.0, "high": 0.05}
    words = tell(weak)
    assert "random search does better even where there is none" in words[1]
    assert "too kind" not in words[2]


def test_a_panel_has_a_line_for_every_defence() -> None:
    (figure,) = draw(numbers(0.1)).values()
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [NONE, "jpeg=75"]
