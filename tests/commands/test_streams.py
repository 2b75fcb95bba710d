"""Standard output and error that are full, closed, or lack characters: one line at most, and a fitting exit code."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cloak_core import __version__, cli
from cloak_core.cli import in_words

ROOT = Path(__file__).parents[2]
ASCII = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}


def cloak(line: str, **options: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "cloak_core", *line.split()]
    return subprocess.run(command, check=False, cwd=ROOT, **({"stderr": subprocess.PIPE} | options))


@pytest.mark.slow
@pytest.mark.parametrize("line", ["--version", "scene info sample:train[0:1] --json", "scene info --help"])
def test_a_full_disk_is_one_line(line: str) -> None:
    with open("/dev/full", "w") as full:
        done = cloak(line, stdout=full)
    said = done.stderr.decode()
    assert done.returncode == 2, said
    assert said == "cloak: standard output: cannot be written (No space left on device)\n"


@pytest.mark.slow
@pytest.mark.parametrize("line", ["--help", "scene info sample:train[0:1]"])
def test_a_reader_who_has_had_enough_is_no_error(line: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as pipe:
        done = cloak(line, stdout=pipe)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.slow
def test_a_terminal_without_the_characters(tmp_path: Path) -> None:
    """Help, results and errors hold characters beyond ASCII."""
    environment = os.environ | ASCII
    helped = cloak("train --help", env=environment, stdout=subprocess.PIPE)
    assert helped.returncode == 0 and not helped.stderr and helped.stdout.isascii()
    refused = cloak("train --nonsense", env=environment, stdout=subprocess.PIPE)
    assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1 and b"---" not in refused.stderr
    absent = cloak("scene info \N{GREATER-THAN OR EQUAL TO}", env=environment, stdout=subprocess.PIPE)
    assert absent.returncode == 2 and absent.stderr.isascii() and len(absent.stderr.splitlines()) == 1


def test_a_line_break_in_a_path_makes_no_second_line(tmp_path: Path) -> None:
    (tmp_path / "two\nlines").mkdir()
    command = """
import logging, sys, warnings
from cloak_core import cli
from cloak_core.commands.base import warn
sys.argv = ["cloak", "scene", "info", "two\\nlines"]
cli.prepare_streams()
warn("one\\ntwo")
warnings.warn("three\\nfour", stacklevel=1)
logging.getLogger("cloak").warning("%s: skipped", "five\\nsix")
cli.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    lines = done.stderr.splitlines()
    assert done.returncode == 2 and len(lines) == 4, done.stderr
    assert all(line.startswith("cloak: ") for line in lines)


def closed(line: str, *descriptors: int) -> subprocess.CompletedProcess:
    """Run a command with these descriptors closed."""
    close = " ".join(f"{number}>&-" for number in descriptors)
    command = f"{sys.executable} -m cloak_core {line} {close}"
    return subprocess.run(command, shell=True, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.slow
def test_standard_output_that_is_closed() -> None:
    """Words for people are lost, which is what they asked for; JSON is not lost in silence."""
    done = closed("scene info sample:train[0:1]", 1)
    assert (done.returncode, done.stderr) == (0, "")
    done = closed("scene info sample:train[0:1] --json", 1)
    assert (done.returncode, done.stderr) == (2, "cloak: standard output: closed, and --json writes there\n")


@pytest.mark.slow
@pytest.mark.parametrize("descriptors", [(2,), (0, 1, 2)])
def test_standard_error_that_is_closed(descriptors: tuple[int, ...], tmp_path: Path) -> None:
    """No file that is opened becomes standard error."""
    out = tmp_path / "chest.npy"
    done = closed(f"logo select --scene sample:train[0:1] --region chest --out {out}", *descriptors)
    assert done.returncode == 0 and out.read_bytes().startswith(b"\x93NUMPY")
    assert closed("scene info absent", *descriptors).returncode == 2


def test_standard_error_that_is_full_ends_nothing() -> None:
    with open("/dev/full", "w") as full:
        done = cloak("scene info absent", stderr=full, stdout=subprocess.PIPE)
    assert done.returncode == 2 and not done.stdout


NOISY = """
import os, subprocess, sys, torch
os.write(1, b"noise\\n")
subprocess.run([sys.executable, "-c", "print('of a child')"])
print("of Python")

class Mine(torch.nn.Module):
    def forward(self, images):
        os.write(1, b"while it runs\\n")
        return torch.zeros(len(images), 1, 4), images.mean(dim=(1, 2, 3))[:, None]

def load():
    return Mine()
"""


@pytest.mark.long
def test_what_a_detector_writes_on_the_descriptor_stays_out_of_the_json(tmp_path: Path) -> None:
    from PIL import Image

    (tmp_path / "noisy.py").write_text(NOISY)
    Image.new("RGB", (32, 32)).save(tmp_path / "a.png")
    line = f"detectors check python:{tmp_path / 'noisy.py'}:load --image {tmp_path / 'a.png'} --json"
    done = cloak(line, stdout=subprocess.PIPE)
    assert done.returncode == 0 and json.loads(done.stdout)["boxes"] == []
    for noise in (b"noise", b"of a child", b"of Python", b"while it runs"):
        assert noise in done.stderr


LIMITED = """
import resource, sys
from cloak_core import cli
import cloak_core.commands.{module}
{warm}
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {left} * 2**20,) * 2)
cli.main(sys.argv[1:])
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("module", "line", "left"),
    [
        ("scene", "scene info sample", 10),
        ("scene", "scene sample --out {out}", 10),
        ("train", "train --scene sample:train --logo chest --out {out} --steps 2 --batch 64", 12),
        ("train", "train --scene sample:train --logo chest --out {out} --steps 2 --batch 64", 200),
        ("detectors", "detectors verify builtin", 5),
    ],
)
def test_little_memory_is_one_line(module: str, line: str, left: int, tmp_path: Path) -> None:
    """The limits are such that an array or a library of some MiB is what finds no room, with a MiB or more left over.

    Where the last KiB are used up, C code of others may crash (a run ended in a segmentation fault), and so may torch
    while it is loaded and numba while it compiles: both are done before the limit. No Python can put that into words.
    """
    if module == "train":
        small = "--steps 1 --batch 1 --size 96 --translation 4"
        with pytest.raises(SystemExit, match="0"):
            cli.main(f"{line.format(out=tmp_path / 'warm')} {small}".split())
    script = LIMITED.format(module=module, left=left, warm="import torch, cloak_core.library.training")
    command = [sys.executable, "-c", script, *line.format(out=tmp_path / "out").split()]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert "memory" in done.stderr.splitlines()[-1]


OLD_RUN = ROOT / "tests" / "old_versions" / "v0.1.0" / "done"


@pytest.mark.long
def test_a_run_folder_whose_name_is_not_utf_8(tmp_path: Path) -> None:
    folder = os.fsencode(tmp_path) + b"/run-\xff"
    shutil.copytree(os.fsencode(OLD_RUN), folder)
    command = [os.fsencode(sys.executable), b"-m", b"cloak_core", b"report", folder, b"--json"]
    done = subprocess.run(command, capture_output=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr.decode()
    assert Path(json.loads(done.stdout)["report"]).read_text("utf-8").startswith("<!")


@pytest.mark.parametrize("line", ["--version --json", "--json --version"])
def test_the_version_as_json(line: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(line.split())
    assert not end.value.code and json.loads(capsys.readouterr().out) == {"version": __version__}


def test_errors_that_are_no_defects_have_words(tmp_path: Path) -> None:
    import torch

    for error in (
        MemoryError("Unable to allocate 8 GiB"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes."),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB"),
        OSError(12, "Cannot allocate memory"),
        ImportError("libtorch.so: failed to map segment from shared object: Cannot allocate memory"),
        ImportError("pandas/_libs/lib.so: failed to map segment from shared object"),
    ):
        assert in_words(error).startswith("not enough memory ("), error
    assert in_words(OSError(28, "No space left on device", "a.npy")) == (
        "a.npy: cannot be written (No space left on device)"
    )
    for defect in (RuntimeError("shapes differ"), ImportError("no module"), OSError(5, "Input/output error")):
        assert in_words(defect) is None
