"""Fits of a made person of whom everything is known, and her pictures by loops and by torch."""

import json

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation

from cloak_core.core.images import dressed
from cloak_core.core.logo import Cover
from cloak_core.core.paint import blank
from cloak_core.core.visibility.compiled import torch_alone
from cloak_core.files.errors import InputError
from cloak_core.patterns.cloth import ClothPattern, Grid
from cloak_core.patterns.controls import OwnClothing
from cloak_core.patterns.faces import FacePattern
from cloak_core.sources.bodies.opening import load_scene
from cloak_core.sources.bodies.people.samples import sample_bodies
from cloak_core.sources.photographs import fitting
from cloak_core.sources.photographs.annotation import INDEX, Landmarks
from cloak_core.sources.photographs.fits import fit_people, pack_fit, unpack_fit
from cloak_core.sources.photographs.fitting import _drawn_out, fit_all
from cloak_core.sources.photographs.people import load_people
from cloak_core.sources.photographs.posing import pose_to
from cloak_core.sources.photographs.rig import ANNY, NUMBER, body_rig, faces_on_rig
from cloak_core.sources.photographs.views import EXACT, FitJitter, Framing, framing_of, logo_positions, photograph_view
from tests.sources.photographs.made_people import (
    annotation,
    landmarks_of,
    photograph,
    run_lengths,
    standing,
    write_people,
)

pytestmark = pytest.mark.slow


def person_of(folder, posed, kind="blazepose", beyond=0):
    """A made person and her true triangles; beyond: pixels by which her mask reaches beyond the body."""
    folder.mkdir(exist_ok=True)
    record, triangle = annotation(posed, kind=kind)
    photograph(triangle >= 0).save(folder / "made.png")
    height, width = triangle.shape
    if beyond:
        mask = binary_dilation(triangle >= 0, iterations=beyond)
        record["segmentation"] = {"size": [height, width], "counts": run_lengths(mask)}
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
    assert fit.quality["landmark_px"] < 0.5 and fit.quality["covered"] > 0.9 and fit.quality["spilled"] < 0.05
    np.testing.assert_allclose(np.add.reduceat(fit.share, fit.crow[:-1]), 1, atol=1e-5)
    row = np.repeat(np.arange(len(fit.pixels)), np.diff(fit.crow))
    of_main = np.bincount(row, fit.share * (fit.triangle == fit.main[row]))
    np.testing.assert_allclose(np.maximum.reduceat(fit.share, fit.crow[:-1]), of_main)
    centre = rig.vertices[rig.triangles].mean(axis=1)
    truth = triangle[triangle.shape[0] - person.mask.shape[0] :, :].ravel()[fit.pixels]
    away = np.linalg.norm(fit.rest - centre[truth], axis=1)
    # Half of the pixels within a face or two, nine in ten within a hand's breadth.
    assert np.median(away) < 0.04 and np.quantile(away, 0.9) < 0.12


@pytest.mark.parametrize(("azimuth", "facing"), [(0, 1), (180, -1)])
def test_what_a_mask_has_beyond_the_body_is_dressed_by_the_pixel_nearest_to_it(tmp_path, azimuth, facing):
    person, _ = person_of(tmp_path, standing(azimuth), beyond=4)
    fit, width = fit_all([person])[0], person.shape[1]
    borrows = (fit.lender != fit.pixels) & np.isin(fit.lender, fit.pixels)
    (x, y), (from_x, from_y) = ((at[borrows] % width, at[borrows] // width) for at in (fit.pixels, fit.lender))
    assert 500 < borrows.sum() and np.hypot(x - from_x, y - from_y).max() < 10
    of_pixel = np.full(person.mask.size, -1)
    of_pixel[fit.pixels] = np.arange(len(fit.pixels))
    moved = fit.rest[borrows] - fit.rest[of_pixel[fit.lender[borrows]]]
    np.testing.assert_allclose(moved[:, 0], facing * (x - from_x) / fit.scale, atol=1e-9)
    np.testing.assert_allclose(moved[:, 1], (from_y - y) / fit.scale, atol=1e-9)


def test_hands_lend_less_far_than_clothes_and_never_more_than_is_near():
    row = np.full((3, 60), -1)
    row[:, 20:25], row[:, 40] = 7, 9
    segment = np.where(row == 7, NUMBER["chest"], np.where(row == 9, NUMBER["l_hand"], -1))
    mask = np.zeros(row.shape, bool)
    mask[1, 2:59] = True
    pixels, lender = _drawn_out(row, segment, mask, 100)  # clothes reach 12 pixels, a hand 2
    assert dict(zip((pixels - 60).tolist(), lender.tolist(), strict=True)) == {
        **dict.fromkeys(range(8, 37), 7),
        **dict.fromkeys(range(38, 43), 9),
    }


@pytest.mark.parametrize("rounds", [fitting.ROUNDS, fitting.ROUNDS - 1])
def test_limbs_become_as_wide_as_the_mask_says_and_stay_so(tmp_path, monkeypatch, rounds):
    monkeypatch.setattr(fitting, "ROUNDS", rounds)
    true, rig = standing(), body_rig()
    at = landmarks_of(true, rig)
    widths = {"l_thigh": 1.3, "r_thigh": 1.3, "l_shin": 0.8, "r_shin": 0.8}
    visibility = np.where(np.arange(len(at)) < INDEX["l_heel"], 1.0, 0.0)
    person, _ = person_of(tmp_path, pose_to(Landmarks(at[:, :2], at[:, 2], visibility), rig, widths))
    fit = fit_all([person])[0]
    for name, width in {**widths, "chest": 1.0, "l_forearm": 1.0}.items():
        size = np.linalg.svd(fit.posed.transforms[NUMBER[name], :, :3], compute_uv=False)
        across = size[0] if width > 1 else size[-1]
        assert across / fit.scale == pytest.approx(width, abs=0.12), name


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


def test_a_pixel_shows_the_point_of_the_body_that_lies_there(fitted):
    rig, own = body_rig(), fitted.lender == fitted.pixels
    corners = rig.triangles[fitted.main[own]]
    with_one = lambda places: np.concatenate([places, np.ones((*places.shape[:-1], 1))], axis=-1)
    weights = np.linalg.pinv(with_one(rig.vertices[corners]).transpose(0, 2, 1)) @ with_one(fitted.rest[own])[..., None]
    seen = (weights * fitted.posed.vertices(rig)[corners]).sum(axis=1)[:, :2]
    row, column = np.divmod(fitted.pixels[own], fitted.person.shape[1])
    away = np.linalg.norm(seen - np.stack([column + 0.5, -(row + 0.5)], axis=1), axis=1)
    assert np.median(away) < 1e-6 and away.max() < 2 and weights.min() > -1e-9


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


FRAMINGS = {
    "close": lambda height: Framing(3.0, 2.0, height / 2, 200),
    "far, mirrored, soft, beyond the border": lambda height: Framing(-40.5, -10.25, 1.7 * height, 61, True, 1.7),
    "mirrored": lambda height: Framing(0.0, 0.0, 0.6 * height, 96, True),
    "nobody": lambda height: Framing(-2 * height, 0.0, height, 32),
}
PATTERNS = {
    "faces": FacePattern,
    "own": OwnClothing,
    "large squares": lambda cover: ClothPattern(cover, Grid.of(0.25, 0.05)),
    "small squares": lambda cover: ClothPattern(cover, Grid.of(0.25, 0.001)),
}


@pytest.mark.parametrize("framing", FRAMINGS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_images_and_gradients_of_both_backends(fitted, framing: str, pattern: str) -> None:
    bodies, asked = sample_bodies(), FRAMINGS[framing](float(fitted.person.shape[0]))
    ids = np.flatnonzero(bodies.regions["shirt"] | bodies.regions["trousers"]).astype(np.int64)
    chosen = PATTERNS[pattern](Cover(ids, bodies.topology))
    random = torch.Generator().manual_seed(0)
    upstream = torch.rand(1, 3, asked.size, asked.size, generator=random)

    def drawn() -> tuple[torch.Tensor, torch.Tensor]:
        position = logo_positions(bodies.topology, ids)
        view = photograph_view(fitted, position, len(ids), asked, FitJitter(folds=1.3, exposure=0.8))
        assert view.is_whole and view.front_count == view.map.height
        assert (view.map.height == 0) == (framing == "nobody")
        values, other = torch.rand(view.map.width, 3), torch.rand(view.map.height, 3)
        products = (view.map.apply(values) * other).sum(), (values * view.map.adjoint(other)).sum()
        torch.testing.assert_close(*products, rtol=1e-5, atol=1e-6)
        canvas = dressed([view], chosen, blank(1, asked.size, asked.size).fill_(0))
        colors = torch.rand(canvas.logo_count, 3, generator=random.manual_seed(1)).requires_grad_()
        image = canvas.paint(colors)
        image.backward(upstream)
        return image.detach().clone(), colors.grad

    ours = drawn()
    with torch_alone():
        theirs = drawn()
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=2e-6)
