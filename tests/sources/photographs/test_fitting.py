"""Fits of a made person of whom everything is known: faces lie where they truly are."""

import json

import numpy as np
import pytest
import torch

from cloak_core.core.images import dressed
from cloak_core.core.logo import Cover
from cloak_core.core.paint import blank
from cloak_core.files.errors import InputError
from cloak_core.jobs.processes import Processes
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.photographs.fits import fit_people, pack_fit, unpack_fit
from cloak_core.sources.photographs.fitting import fit_all
from cloak_core.sources.photographs.people import load_people
from cloak_core.sources.photographs.rig import ANNY, body_rig, faces_on_rig
from cloak_core.sources.photographs.views import EXACT, FitJitter, Framing, framing_of, logo_positions, photograph_view
from tests.sources.photographs.made_people import annotation, photograph, standing, write_people

pytestmark = pytest.mark.slow


def person_of(folder, posed, kind="blazepose"):
    folder.mkdir(exist_ok=True)
    record, triangle = annotation(posed, kind=kind)
    photograph(triangle >= 0).save(folder / "made.png")
    height, width = triangle.shape
    images = [{"id": 1, "file_name": "made.png", "width": width, "height": height}]
    (folder / "p.json").write_text(json.dumps({"images": images, "annotations": [record]}))
    (person,) = load_people(folder / "p.json").people
    return person, triangle


@pytest.mark.parametrize(
    ("azimuth", "swing", "kind"),
    [(0, 0, "blazepose"), (80, 0, "blazepose"), (180, 0, "blazepose"), (40, 20, "blazepose"), (0, 0, "coco")],
)
def test_faces_lie_where_they_truly_are(tmp_path, azimuth, swing, kind):
    person, triangle = person_of(tmp_path, standing(azimuth, swing), kind)
    fit, rig = fit_all([person])[0], body_rig()
    assert fit.quality["landmark_px"] < 0.5 and fit.quality["covered"] > 0.9
    centre = rig.vertices[rig.triangles].mean(axis=1)
    truth = triangle[triangle.shape[0] - person.mask.shape[0] :, :].ravel()[fit.pixels]
    away = np.linalg.norm(fit.rest - centre[truth], axis=1)
    # Half of the pixels within a face or two, nine in ten within a hand's breadth.
    assert np.median(away) < 0.04 and np.quantile(away, 0.9) < 0.12


@pytest.mark.parametrize("cache", ["kept", "off"])
def test_fits_come_back_from_the_cache_with_the_same_bits(tmp_path, monkeypatch, cache):
    monkeypatch.setenv("CLOAK_CACHE", "off" if cache == "off" else str(tmp_path / "cache"))
    people = load_people(write_people(tmp_path / "people", 1))
    first, again = fit_people(people)[0], fit_people(people)[0]
    assert first.identity == again.identity and np.array_equal(first.rest, again.rest)


def test_a_stored_fit_is_small_and_its_views_are_the_same(fitted):
    packed = pack_fit(fitted)
    assert len(packed) < 400_000
    stored = unpack_fit(packed, fitted.person)
    for jitter in (EXACT, FitJitter(move=(0.02, 0.01), folds=1.3)):
        framing = framing_of(fitted, size=96)
        one, other = (dressed_image(fit, framing, 0.4, jitter)[0] for fit in (fitted, stored))
        assert np.abs(one - other).max() < 1e-3
    assert np.array_equal(stored.rest, fitted.rest)


def test_processes_fit_people_to_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setenv("CLOAK_CACHE", "off")
    people = load_people(write_people(tmp_path, 2))
    here, there = fit_people(people), fit_people(people, executor=Processes(1))
    assert [fit.identity for fit in here] == [fit.identity for fit in there]


@pytest.mark.parametrize("scene", ["sample", "sample-clothed:unseen"])
def test_every_clothed_face_of_a_known_topology_is_somewhere_on_the_rig(scene):
    bodies = load_scene(scene)
    face = faces_on_rig(bodies.topology)
    shirt = np.flatnonzero(bodies.regions["shirt"])
    assert face.max() < bodies.face_count and np.isin(shirt, face).all()


def test_annys_faces_are_the_halves_of_the_quads_and_another_topology_is_refused():
    face = faces_on_rig(ANNY)
    assert len(np.unique(face)) == len(face) == 26972 and face.max() == 27419
    with pytest.raises(InputError, match="people in photographs wear logos of"):
        faces_on_rig("0" * 64)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    person, _ = person_of(tmp_path_factory.mktemp("fitted"), standing(20, 5))
    return fit_all([person])[0]


def dressed_image(fit, framing, color, jitter=EXACT):
    bodies = load_scene("sample")
    ids = np.flatnonzero(bodies.regions["shirt"] | bodies.regions["trousers"]).astype(np.int64)
    view = photograph_view(fit, logo_positions(bodies.topology, ids), len(ids), framing, jitter)
    canvas = dressed([view], FacePattern(Cover(ids, bodies.topology)), blank(1, framing.size, framing.size).fill_(0))
    image = canvas.paint(torch.full((len(ids), 3), color))[0].numpy()
    return image, view, view.places.shares.to_scipy()


def test_pixels_off_the_clothes_are_the_photographs(fitted):
    height, width = fitted.person.mask.shape
    framing = Framing(0.0, 0.0, float(min(height, width)), min(height, width))
    image, _, shares = dressed_image(fitted, framing, 0.5)
    side = framing.size
    photo = fitted.person.image[:side, :side].transpose(2, 0, 1) / 255
    bare = np.ones(height * width, bool)
    bare[fitted.pixels[np.asarray(shares.sum(axis=1)).ravel() > 0]] = False
    bare = bare.reshape(height, width)[:side, :side]
    assert np.abs(image - photo)[:, bare].max() < 1e-5
    assert np.abs(image - photo)[:, ~bare].mean() > 0.02


def test_jitter_moves_faces_and_never_leaves_the_clothes(fitted):
    framing = framing_of(fitted, size=96)
    _, tight, shares = dressed_image(fitted, framing, 0.4)
    _, loose, moved = dressed_image(fitted, framing, 0.4, FitJitter(move=(0.05, 0.0)))
    assert (shares != moved).nnz > 100
    assert tight.box == loose.box
    assert (np.asarray(moved.sum(axis=1)).ravel() <= 1 + 1e-6).all()
