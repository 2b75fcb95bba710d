"""Wear: the cloak on people in photographs, from the panel."""

import json

import bpy
import pytest
from cloak.result import reasons
from conftest import folder_of, run_job


def test_people_wear_the_run_and_the_panel_tells_before_and_after(dressed, tmp_path):
    judging = bpy.context.scene.cloak.judging
    with pytest.raises(RuntimeError, match="People is empty"):
        bpy.ops.cloak.wear()
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    judging.people = str(photographs)
    with pytest.raises(RuntimeError, match=r"no people.json in it"):
        bpy.ops.cloak.wear()
    (photographs / "people.json").write_text(json.dumps({"images": [1, 2, 3, 4], "annotations": []}))
    with pytest.raises(RuntimeError, match=r"poll\(\).*'Body' is none of them: train on the sample body, or carry"):
        bpy.ops.cloak.wear()
    dressed.cloak.made_from = "sample:train|0"
    bpy.ops.cloak.wear()
    job = run_job()
    assert (job.state, job.message) == ("done", "2 people wear it")
    worn = reasons.last_worn(folder_of(dressed))
    assert (worn.people, worn.left_out, len(worn.pictures)) == (2, 1, 8)
    (judged,) = worn.detectors
    rates = {name: own.value for name, (_, own) in judged.rates.items()}
    assert judged.spec == "builtin" and rates == {"run": 0.5, "clothing": 0.0, "grey": 0.05, "random": 0.1}
    assert [path.stem for path in worn.pictures[:2]] == ["before", "after run"]
    bpy.ops.cloak.wear()
    run_job()
    assert reasons.last_worn(folder_of(dressed)).folder.name == "worn by people 2"
