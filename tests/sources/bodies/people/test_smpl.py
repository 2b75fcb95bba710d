"""SMPL on random model files of the true shapes; with the `smplx` package at hand, against it."""

import pickle
import pickletools
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from cloak_core.files.errors import InputError
from cloak_core.sources.bodies.people.smpl import import_smpl, pose_smpl, read_smpl

PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]


def random_model(vertices: int = 300, joints: int = 24, shapes: int = 10, seed: int = 0) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    parents = PARENTS if joints == 24 else [-1, *(int(random.integers(0, j)) for j in range(1, joints))]
    regressor = random.random((joints, vertices)) ** 20
    weights = random.random((vertices, joints)) ** 8
    return {
        "v_template": random.normal(size=(vertices, 3)) * [0.3, 0.8, 0.2],
        "shapedirs": random.normal(size=(vertices, 3, shapes)) * 0.03,
        "posedirs": random.normal(size=(vertices, 3, 9 * (joints - 1))) * 0.005,
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.array([[p % (1 << 32) for p in parents], range(joints)], np.uint32),
        "f": random.integers(0, vertices, (2 * vertices, 3)).astype(np.uint32),
    }


def random_poses(count: int, joints: int = 24, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 3 * joints)) * 0.4, random.normal(size=(count, 10))


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    np.savez(tmp_path / "model.npz", **random_model())
    return tmp_path / "model.npz"


def plain_smpl(model: dict[str, np.ndarray], pose: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """One body by the book, joint by joint with 4 x 4 matrices."""
    shaped = model["v_template"] + model["shapedirs"][..., : len(betas)] @ betas
    joints = model["J_regressor"] @ shaped
    turns = [rotation(vector) for vector in pose.reshape(-1, 3)]
    posed = shaped + model["posedirs"] @ np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    world = []
    for joint, turn in enumerate(turns):
        parent = int(model["kintree_table"][0, joint]) if joint else None
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turn, joints[joint] - (joints[parent] if joint else 0)
        world.append(world[parent] @ local if joint else local)
    moved = np.zeros_like(posed)
    for joint, matrix in enumerate(world):
        here = matrix[:3, :3] @ (posed - joints[joint]).T
        moved += model["weights"][:, joint, None] * (here.T + matrix[:3, 3])
    return moved


def rotation(vector: np.ndarray) -> np.ndarray:
    """By the power series of the matrix exponential."""
    x, y, z = vector
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    term, total = np.eye(3), np.eye(3)
    for n in range(1, 40):
        term = term @ k / n
        total = total + term
    return total


@pytest.mark.parametrize("joints", [24, 52, 55])
def test_forward_by_the_book(tmp_path: Path, joints: int) -> None:
    model = random_model(joints=joints)
    np.savez(tmp_path / "m.npz", **model)
    poses, betas = random_poses(40, joints)
    vertices = pose_smpl(read_smpl(tmp_path / "m.npz"), poses, betas)
    for index in (0, 17, 39):
        assert np.abs(vertices[index] - plain_smpl(model, poses[index], betas[index])).max() < 1e-5


# --- the original pickles --------------------------------------------------------------------------------------------


def stand_in(module: str, name: str, monkeypatch: pytest.MonkeyPatch) -> type:
    """A class of a module that is not installed, for pickling only."""
    for depth in range(1, module.count(".") + 2):
        part = ".".join(module.split(".")[:depth])
        if part not in sys.modules:
            monkeypatch.setitem(sys.modules, part, types.ModuleType(part))
    kind = type(name, (), {"__module__": module})
    monkeypatch.setattr(sys.modules[module], name, kind, raising=False)
    return kind


def pickled(model: dict, monkeypatch: pytest.MonkeyPatch, protocol: int) -> bytes:
    """As the original files: chumpy for the blend shapes, a scipy sparse matrix for the regressor."""
    import scipy.sparse

    ch = stand_in("chumpy.ch", "Ch", monkeypatch)
    select = stand_in("chumpy.reordering", "Select", monkeypatch)
    shapes, template = ch(), select()
    shapes.__dict__.update(x=model["shapedirs"], dirty=True)
    order = np.arange(model["v_template"].size)[::-1]
    template.__dict__.update(
        a=model["v_template"].ravel()[order], idxs=order, preferred_shape=model["v_template"].shape
    )
    content = {**model, "shapedirs": shapes, "v_template": template}
    content["J_regressor"] = scipy.sparse.csc_matrix(model["J_regressor"])
    return pickle.dumps(content, protocol)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_original_pickles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, protocol: int) -> None:
    model = random_model()
    (tmp_path / "m.pkl").write_bytes(pickled(model, monkeypatch, protocol))
    monkeypatch.undo()
    read = read_smpl(tmp_path / "m.pkl")
    assert np.allclose(read.template.T, model["v_template"])
    assert np.allclose(read.joints.reshape(-1, 3), model["J_regressor"] @ model["v_template"])
    poses, betas = random_poses(3)
    np.savez(tmp_path / "m.npz", **model)
    assert np.array_equal(pose_smpl(read, poses, betas), pose_smpl(read_smpl(tmp_path / "m.npz"), poses, betas))


class Harmful:
    def __init__(self, call: object, *args: object) -> None:
        self.call, self.args = call, args

    def __reduce__(self) -> tuple:
        return self.call, self.args


def test_a_pickle_that_would_run_something_is_refused_by_name(tmp_path: Path) -> None:
    mark = tmp_path / "ran"
    for call, args, name in (
        (Path.touch, (mark,), "getattr|touch|PosixPath|Path"),
        (eval, (f"open({str(mark)!r}, 'w')",), "eval"),
    ):
        (tmp_path / "m.pkl").write_bytes(pickle.dumps({**random_model(), "extra": Harmful(call, *args)}))
        with pytest.raises(InputError, match=rf"m\.pkl: the pickle holds .*({name})"):
            read_smpl(tmp_path / "m.pkl")
        assert not mark.exists()


CODES = {
    name: b"\x80\x04" + b"".join(b"\x8c" + bytes([len(n)]) + n.encode() for n in name.rsplit(" ", 1)) + b"\x93)R."
    for name in ("numpy load", "numpy.core.multiarray fromfile", "chumpy.ch os.system", "scipy.sparse load_npz")
}
CODES["an array of 100 GB"] = b"\x80\x02cnumpy\nndarray\n(I99999999999\nt\x85R."


@pytest.mark.parametrize("code", CODES)
def test_only_the_listed_names_are_admitted_and_none_allocates(tmp_path: Path, code: str) -> None:
    assert list(pickletools.genops(CODES[code]))
    (tmp_path / "m.pkl").write_bytes(CODES[code])
    with pytest.raises(InputError, match=r"m\.pkl" if "array of" in code else "never loaded"):
        read_smpl(tmp_path / "m.pkl")


# --- models and poses that do not fit --------------------------------------------------------------------------------


def test_models_that_lack_arrays_or_have_wrong_shapes(tmp_path: Path) -> None:
    model = random_model()
    lacking = {key: value for key, value in model.items() if key not in ("posedirs", "f")}
    np.savez(tmp_path / "lacking.npz", **lacking)
    with pytest.raises(InputError, match=r"lacking\.npz: .*posedirs, f"):
        read_smpl(tmp_path / "lacking.npz")
    np.savez(tmp_path / "wrong.npz", **{**model, "posedirs": model["posedirs"][..., :200]})
    with pytest.raises(InputError, match=r"posedirs is \(300, 3, 200\), not \(300, 3, 207\)"):
        read_smpl(tmp_path / "wrong.npz")
    np.savez(tmp_path / "nan.npz", **{**model, "weights": model["weights"] * np.nan})
    with pytest.raises(InputError, match="weights is not all finite"):
        read_smpl(tmp_path / "nan.npz")
    with pytest.raises(InputError, match="no such model"):
        read_smpl(tmp_path / "gone.npz")


def test_amass_files_are_z_up(tmp_path: Path, model_file: Path) -> None:
    poses, _ = random_poses(5, 52)
    trans = np.arange(15.0).reshape(5, 3)
    np.savez(tmp_path / "walk.npz", poses=poses, betas=np.linspace(-1, 1, 10), trans=trans, mocap_framerate=120.0)
    bodies = import_smpl(model_file, tmp_path / "walk.npz")
    assert bodies.pose_count == 5 and bodies.names[1] == "walk 0001" and bodies.vertex_count == 300
    body = np.concatenate([poses[:, :66], np.zeros((5, 6))], axis=1)
    direct = pose_smpl(read_smpl(model_file), body, np.tile(np.linspace(-1, 1, 10), (5, 1)), trans)
    x, y, z = direct.transpose(2, 0, 1)
    assert np.allclose(bodies.vertices, np.stack([x, z, -y], axis=-1), atol=1e-6)
    assert import_smpl(model_file, tmp_path / "walk.npz", every=2, limit=2).pose_count == 2


def test_surreal_and_rows_agree(tmp_path: Path, model_file: Path) -> None:
    scipy_io = pytest.importorskip("scipy.io")
    poses, betas = random_poses(4)
    scipy_io.savemat(tmp_path / "c_info.mat", {"pose": poses.T, "shape": betas.T, "clip": 3})
    np.save(tmp_path / "rows.npy", np.concatenate([poses, betas], axis=1))
    np.savetxt(tmp_path / "rows.csv", np.concatenate([poses, betas], axis=1), delimiter=",")
    expected = pose_smpl(read_smpl(model_file), poses, betas)
    for name in ("c_info.mat", "rows.npy", "rows.csv"):
        assert np.allclose(import_smpl(model_file, tmp_path / name).vertices, expected, atol=1e-6)


def test_poses_that_do_not_fit(tmp_path: Path, model_file: Path) -> None:
    poses, betas = random_poses(4)
    np.save(tmp_path / "short.npy", poses[:, :70])
    np.savez(tmp_path / "odd.npz", poses=poses[:, :69])
    np.savez(tmp_path / "none.npz", betas=betas)
    np.savez(tmp_path / "many.npz", poses=poses, betas=np.zeros((1, 400)))
    np.savez(tmp_path / "lone.npz", poses=poses, betas=betas[:3])
    np.save(tmp_path / "nan.npy", np.where(np.arange(72) == 7, np.nan, poses))
    (tmp_path / "words.csv").write_text("1,2,three\n")
    (tmp_path / "bad.mat").write_bytes(b"MATLAB?" * 40)
    (tmp_path / "poses.txt").write_text("0")
    says = {
        "short.npy": "70 numbers", "odd.npz": "69 numbers", "none.npz": "no array 'poses'", "many.npz": "400 betas",
        "lone.npz": "3 betas for 4 poses", "nan.npy": "pose 0", "words.csv": "three", "bad.mat": "mat",
        "poses.txt": r"\.npz", "gone.npz": "no such",
    }  # fmt: skip
    for name, words in says.items():
        with pytest.raises(InputError, match=words):
            import_smpl(model_file, tmp_path / name)
