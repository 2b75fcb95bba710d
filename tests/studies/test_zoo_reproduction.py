"""Entries of the zoo judged again: as recorded, with files found by their names, and a changed figure is a failure."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from cloak_core.files.errors import InputError
from cloak_core.studies import zoo_reproduction
from cloak_core.studies.zoo_reproduction import Files, evaluate_again
from cloak_core.zoo.entry import entry, shelved
from tests.core.fakes import RedDetector

RATES = {"success": 0.9, "success_own": 0.5, "ci95": [0.8, 1.0], "ci95_own": [0.4, 0.6], "n": 10}


@pytest.mark.slow
def test_an_entry_is_judged_on_the_images_of_its_record() -> None:
    found = entry("builtin-sample")
    told = json.loads(json.dumps(found.record["evaluation"]))
    told["settings"] |= {"size": 96, "samples": 1, "shift": 5, "most_images": 3, "resamples": 100}
    small = replace(found, record=found.record | {"evaluation": told})
    seen: list[tuple[int, int]] = []
    first = evaluate_again(small, Files(), None, "cpu", lambda *count: seen.append(count))["builtin"]
    assert first["again"]["n"] == 3 and seen and first["recorded"]["success"] == 1.0
    told["detectors"]["builtin"]["logo"] = first["again"]
    again = evaluate_again(small, Files(), None, "cpu", None)["builtin"]
    assert again == {"recorded": first["again"], "again": first["again"], "holds": True}
    told["inputs"]["bodies"] = ["nobody"]
    with pytest.raises(InputError, match="no body nobody, which zoo:builtin-sample was judged on"):
        evaluate_again(small, Files(), None, "cpu", None)


def test_a_figure_holds_within_either_interval() -> None:
    assert zoo_reproduction._holds(RATES, RATES | {"success": 0.8})
    assert zoo_reproduction._holds(RATES, RATES | {"success_own": 0.7, "ci95_own": [0.3, 1.0]})
    assert not zoo_reproduction._holds(RATES, RATES | {"success": 0.7, "ci95": [0.6, 0.8]})
    assert not zoo_reproduction._holds(RATES, RATES | {"success_own": 0.7, "ci95_own": [0.6, 0.8]})


def test_the_command_goes_on_past_missing_files_and_fails_where_a_figure_changed(monkeypatch, cloak) -> None:
    def judged(found, *_) -> dict:
        if found.record["name"] != "builtin-sample":
            raise InputError("a.onnx is not in here")
        return {"builtin": {"recorded": RATES, "again": RATES | {"success": 0.1}, "holds": False}}

    monkeypatch.setattr(zoo_reproduction, "evaluate_again", judged)
    code, out, err = cloak("zoo", "reproduce", "--json")
    told = json.loads(out)
    assert [row["name"] for row in told["zoo"]] == ["builtin-sample"] and len(told["left_out"]) == len(shelved()) - 1
    assert code == 1 and "zoo:builtin-sample: builtin: not what was recorded" in err
    code, _, err = cloak("zoo", "reproduce", "ssd-anny", "--json")
    assert code == 2 and "a.onnx" in err


def test_what_does_not_ship_is_asked_for_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"bodies_anny\.npz, which zoo:ssd-anny was judged with, does not ship"):
        evaluate_again(entry("ssd-anny"), Files(), None, "cpu", None)
    with pytest.raises(InputError, match=r"bodies_anny\.npz, .* is not in "):
        evaluate_again(entry("ssd-anny"), Files(tmp_path), None, "cpu", None)
    (tmp_path / "deep").mkdir()
    for name in ("a-1.2.cfg", "a_3.weights"):
        (tmp_path / "deep" / name).write_bytes(b"")
    asked = []
    monkeypatch.setattr(zoo_reproduction, "load_detector", lambda spec, device: asked.append(spec) or RedDetector())
    for spec in ("darknet:a-1.2.cfg:a_3.weights@224,conf=0.25", "builtin@conf=0.5"):
        zoo_reproduction._detector(spec, Files(tmp_path), "zoo:a", "cpu")
    deep = tmp_path / "deep"
    assert asked == [f"darknet:{deep}/a-1.2.cfg:{deep}/a_3.weights@224,conf=0.25", "builtin@conf=0.5"]
