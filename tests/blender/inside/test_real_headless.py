"""`train.py` without a window and the add-on's command lines, by the project's own trainer."""

import json

import bpy
import numpy as np
import pytest
from cloak.blender import faces
from cloak.blender.evaluated import read_surface
from cloak.body import objects
from cloak.logo import stamp
from cloak.logo.operators import heatmap_words, show_heat
from made import add_ngons, make_egg
from test_headless import RED, reds, train


@pytest.mark.parametrize("subdivisions", [0, 1])
def test_a_letter_trained_to_pure_red_comes_back_red_on_exactly_its_faces(tmp_path, real_trainer, subdivisions):
    """Quads, triangles and n-gons; stamped before subdivision; through saving and reopening; by the real trainer."""
    obj = make_egg(rings=40)
    add_ngons(obj)
    placed = stamp.Placed(read_surface(bpy.context, obj), stamp.text_stamp("G"))
    mask = placed.own_mask(stamp.front_projection(obj, 0.35, 0.55, 0.0, 1.0))
    faces.new_logo(obj, "G", mask)
    sizes = {len(obj.data.polygons[i].vertices) for i in np.flatnonzero(mask)}
    assert {4, 6} <= sizes and mask.sum() > 50
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "body.blend"))
    words = ["--blend", "body.blend", "--logo", "G", "--out", "RUN", "--save", "red.blend", "--steps", 40]
    words += ["--detector", f"python:{RED}:load", "--angles", "-10:10:10", "--subdivide", subdivisions]
    words += ["--backgrounds", "procedural:train:4", "--keep-quads", "--config", "fast.toml"]
    (tmp_path / "fast.toml").write_text("tv_weight = 0\nlr = 0.05\nschedule = 'constant'\nbatch = 4\n")
    done = train(tmp_path, *words, python=real_trainer)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "red.blend"))
    obj = bpy.data.objects["Body"]
    logo = faces.read_faces(obj, "G")
    assert logo.sum() >= mask.sum() * 4**subdivisions
    assert np.array_equal(reds(obj), logo)


def test_sample_body_and_heatmap_of_the_real_trainer(tmp_path, real_trainer):
    """The add-on's command lines are those the trainer understands."""
    from cloak.exchange.scenes import read_scene, write_scene
    from cloak.files.reading import read_npy
    from cloak.poses.export import export_bodies
    from cloak.poses.poses import PoseChoice
    from cloak.trainer.jobs import Job
    from cloak.trainer.program import allow, cloak_command, options, sample_words

    python = str(real_trainer)

    def answer(label: str, command: list[str]) -> str:
        job = Job(label, [command], tmp_path, label).wait(250)
        assert job.state == "done", job.message
        return job.outputs[0]

    facts = json.loads(answer("Test", cloak_command(python, "setup")))
    assert facts["torch"][0].isdigit() and facts["device"]
    answer("Sample", cloak_command(python, *sample_words(tmp_path / "sample")))
    obj = objects.add_from_scene(bpy.context, read_scene(tmp_path / "sample"))
    assert {"chest", "thighs"} <= set(faces.logo_names(obj.data)) and len(obj.data.shape_keys.key_blocks) > 8
    write_scene(tmp_path / "scene", export_bodies(bpy.context, obj, PoseChoice())[0])
    allow([f"python:{RED}:load"])
    given = options([f"python:{RED}:load"], backgrounds="procedural:train:2", angles="0:0:1")
    words = [*heatmap_words(given, tmp_path), "--events", tmp_path / "e"]
    answer("Heatmap", cloak_command(python, *words, "--pick", "0.1"))
    show_heat(obj, read_npy(tmp_path / "heat.npy"))
    bpy.context.scene.cloak.heat_share = 0.1
    bpy.ops.cloak.logo_from_heat()
    picked = np.flatnonzero(faces.read_faces(obj, "Heat"))
    assert picked.tolist() == read_npy(tmp_path / "heat-pick.npy").tolist()  # the command line and Blender agree
    image = bpy.data.images.new("grey", 32, 32)
    image.filepath_raw, image.file_format = str(tmp_path / "grey.png"), "PNG"
    image.save()
    words = ("detectors", "check", f"python:{RED}:load", "--image", tmp_path / "grey.png")
    said = answer("Check", cloak_command(python, *words))
    assert 0 <= json.loads(said)["max_person"] <= 1
