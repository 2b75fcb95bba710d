"""What torch.save wrote is read without torch, and nothing that it says is run."""

import io
import os
import pathlib
import pickle
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from cloak_core.files.errors import InputError
from cloak_core.files.torch_pickles import read_torch_pickle
from cloak_core.files.unpickling import Record


class Runs:
    """Wants a command run where it is loaded."""

    def __init__(self, function: object = os.system, words: tuple = ("touch ran",)) -> None:
        self.function, self.words = function, words

    def __reduce__(self) -> tuple:
        return self.function, self.words


def test_tensors_and_modules(tmp_path: Path) -> None:
    torch.manual_seed(0)
    base = torch.arange(24.0).reshape(4, 6)
    module = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    content = {
        "view": base[1:3, ::2].t(), "half": base.half(), "brain": base.to(torch.bfloat16), "long": torch.tensor(7),
        "expanded": torch.tensor([5.0]).expand(3, 2), "empty": torch.zeros(0, 3), "flag": torch.tensor([True, False]),
        "module": module, "names": ["a", "b"], "path": pathlib.PurePosixPath("x"), "size": torch.Size([2, 3]),
        "device": torch.device("cpu"), "dtype": torch.float16, "set": {1, 2}, "scalar": np.float64(0.5),
    }  # fmt: skip
    torch.save(content, tmp_path / "a.pt")
    found = read_torch_pickle(tmp_path / "a.pt")
    for name in ("view", "half", "brain", "long", "expanded", "empty", "flag"):
        np.testing.assert_array_equal(found[name], content[name].float().numpy())
    assert found["names"] == ["a", "b"] and found["size"] == (2, 3) and found["set"] == {1, 2}
    assert isinstance(found["module"], Record) and found["scalar"] == 0.5
    conv = found["module"].state["_modules"]["0"]
    assert (type(conv).__module__, type(conv).__name__) == ("torch.nn.modules.conv", "Conv2d")
    np.testing.assert_array_equal(conv.state["_parameters"]["weight"], module[0].weight.detach().numpy())


def write(evil: object, form: str) -> None:
    if form == "bare":
        Path("a.pt").write_bytes(pickle.dumps(evil))
    else:
        torch.save({"model": evil}, "a.pt", _use_new_zipfile_serialization=form == "zip")


@pytest.mark.parametrize("form", ["zip", "before 1.6", "bare"])
@pytest.mark.parametrize(
    ("function", "words", "named"),
    [
        (os.system, ("touch ran",), r"(posix|nt)\.system"),
        (eval, ("open('ran', 'w')",), r"built\w+\.eval"),
        (torch.hub.load, ("a/b", "c"), r"torch\.hub\.load"),
    ],
)
def test_what_would_run_is_named(function, words: tuple, named: str, form: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(Runs(function, words), form)
    with pytest.raises(InputError, match=rf"a\.pt: the pickle holds _*{named}, which is never loaded"):
        read_torch_pickle(Path("a.pt"))
    assert not Path("ran").exists()


@pytest.mark.parametrize(
    ("function", "words"), [(nn.init.ones_, (1,)), (getattr, (nn.Identity, "forward")), (pathlib.PosixPath, ("ran",))]
)
def test_what_a_model_may_name_is_not_run_either(function, words: tuple, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(Runs(function, words), "zip")
    record = read_torch_pickle(Path("a.pt"))["model"]
    assert type(record).__bases__ == (Record,) and record.state == {}


def test_torch_before_1_6(tmp_path: Path) -> None:
    torch.save({"a": torch.ones(2)}, tmp_path / "a.pt", _use_new_zipfile_serialization=False)
    with pytest.raises(InputError, match=r"written by a torch older than 1\.6"):
        read_torch_pickle(tmp_path / "a.pt")


def test_torchscript(tmp_path: Path) -> None:
    with warnings.catch_warnings(action="ignore"):
        torch.jit.script(nn.Linear(2, 2)).save(str(tmp_path / "a.pt"))
    with pytest.raises(InputError, match="a TorchScript archive"):
        read_torch_pickle(tmp_path / "a.pt")


def test_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    torch.save({"a": torch.ones(64), "b": nn.Linear(2, 2)}, path)
    whole = path.read_bytes()
    for data in (b"", b"PK\3\4", whole[: len(whole) // 2], whole[:-30], b"\x80\x02", b"no pickle", whole[100:]):
        path.write_bytes(data)
        with pytest.raises(InputError, match="not a whole file") as error:
            read_torch_pickle(path)
        assert "\n" not in str(error.value)


def rewritten(path: Path, change: dict[str, bytes]) -> None:
    """The archive with some of its members replaced."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, change.get(name.partition("/")[2], data))


def test_a_tensor_that_reaches_beyond_its_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    torch.save({"a": torch.ones(64)}, path)
    rewritten(path, {"data/0": b"\0" * 16})
    with pytest.raises(InputError, match="not a whole file"):
        read_torch_pickle(path)
    torch.save({"a": torch.ones(64)}, path)
    with zipfile.ZipFile(path) as archive:
        pickled = archive.read("a/data.pkl")
    longer = pickled.replace(b"K@\x85", b"KA\x85")  # of shape (65,)
    assert longer != pickled
    rewritten(path, {"data.pkl": longer})
    with pytest.raises(InputError, match="a tensor beyond its numbers"):
        read_torch_pickle(path)


def test_an_archive_that_unpacks_to_more_than_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    buffer = io.BytesIO()
    torch.save({"a": torch.ones(4)}, buffer)
    with zipfile.ZipFile(buffer) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
        new.writestr("archive/data/1", b"\0" * (1 << 20))
    assert path.stat().st_size < 1 << 16
    with pytest.raises(InputError, match="too large"):
        read_torch_pickle(path)
