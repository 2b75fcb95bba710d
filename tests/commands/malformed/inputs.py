"""What else a training reads: detectors, pictures, settings, grids, palettes."""

import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.commands.malformed.making import CHECK, RESUME, TRAIN, WEIGHTS, Case, Evil, archive, cfg, png_of, put


def detectors() -> Iterator[Case]:
    texts = {
        "nothing": "",
        "a picture": png_of(8, 8),
        "a width of 10^9": cfg(width=10**9),
        "a negative width": cfg(width=-32),
        "a width of text": cfg(width="x"),
        "10^7 filters": cfg(filters=10**7),
        "no filters": cfg(filters=0),
        "a kernel of 99999": cfg(size=99999),
        "a stride of zero": cfg(stride=0),
        "groups that do not divide": cfg(groups=7),
        "an unknown activation": cfg(activation="exec"),
        "a hundred layers of 9000 filters": cfg().replace(
            "[region]", "[convolutional]\nfilters=9000\nsize=3\nstride=1\nactivation=linear\n" * 100 + "[region]"
        ),
        "a route to nowhere": cfg().replace("[region]", "[route]\nlayers=-40\n[region]"),
        "a route to itself": cfg().replace("[region]", "[route]\nlayers=1\n[region]"),
        "a shortcut to nowhere": cfg().replace("[region]", "[shortcut]\nfrom=-40\n[region]"),
        "upsampling by 10^6": cfg().replace("[region]", "[upsample]\nstride=1000000\n[region]"),
        "anchors that are no numbers": cfg().replace("1,1,", "nan,x,"),
        "10^9 anchors": cfg().replace("num=5", "num=1000000000"),
        "10^9 classes": cfg().replace("classes=1", "classes=1000000000"),
        "no end": cfg().replace("[region]", ""),
        "an unknown section": cfg().replace("[region]", "[exec]"),
        "keys without values": "[net]\nwidth\n",
        "a million lines": "[net]\n" + "\n" * 1_100_000,
    }
    for name, data in texts.items():
        yield Case(f"cfg: {name}", put("net.cfg", data), CHECK + " photo.png")
    weights = {
        "nothing": b"",
        "a header alone": WEIGHTS[:20],
        "half of it": WEIGHTS[:300],
        "a byte more": WEIGHTS + b"0",
        "twice": WEIGHTS + WEIGHTS[20:],
        "a pickle": pickle.dumps(Evil()),
        "not numbers": WEIGHTS[:20] + b"\xff" * 480,
    }
    for name, data in weights.items():
        yield Case(f"weights: {name}", put("net.weights", data), CHECK + " photo.png")
    for spec in ("darknet:net.cfg", "darknet::", "darknet:scene:photos", "nonsense:x", "onnx:photo.png", "onnx:scene"):
        yield Case(f"detector {spec}", put("x", ""), f"detectors check {spec} --image photo.png")
    torch_file = "torchvision:ssdlite320_mobilenet_v3_large:evil.pth"
    evil = {"pickle": pickle.dumps(Evil()), "zip": archive({"archive/data.pkl": pickle.dumps(Evil()),
            "archive/version": b"3"}), "nothing": b""}  # fmt: skip
    for name, data in evil.items():
        yield Case(f"checkpoint of torchvision: {name}", put("evil.pth", data),
                   f"detectors check {torch_file} --image photo.png")  # fmt: skip


def pictures() -> Iterator[Case]:
    bad = {
        "nothing": b"",
        "text": b"not a picture",
        "a pickle": pickle.dumps(Evil()),
        "60000 x 60000": png_of(60000, 60000),
        "2^31 x 2^31": png_of(2**31 - 1, 2**31 - 1),
        "13000 x 13000, transparent": png_of(13000, 13000, rows=13000),
        "truncated": png_of(64, 64)[:60],
        "an SVG that asks for a file": b"<svg><image href='file:///etc/passwd'/></svg>",
        "PostScript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(x) run\n",
        "a zip": archive({"a": b"b"}),
    }
    for name, data in bad.items():
        # A large picture is no bad one: it may be read, within the memory there is.
        may = "transparent" in name
        yield Case(f"photograph: {name}", put("bad.png", data), CHECK + " bad.png", may)
        yield Case(f"background: {name}", put("photos/0.png", data), TRAIN, may)
        stamp = "logo project --scene sample:train[0:1] --mask bad.png --out x.npy"
        yield Case(f"stamp: {name}", put("bad.png", data), stamp, may)


SPECIAL = {
    "a pipe": lambda path: os.mkfifo(path),
    "a link to /dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a folder": lambda path: path.mkdir(),
}
READ_BY = {
    "photo.png": CHECK + " photo.png", "net.cfg": CHECK + " photo.png", "net.weights": CHECK + " photo.png",
    "net.names": CHECK + " photo.png", "whole.npz": "scene info whole.npz", "scene/scene.json": "scene info scene",
    "scene/bodies.npz": "scene info scene", "logo.npy": TRAIN, "logo.json": TRAIN, "photos/0.png": TRAIN,
    "settings.toml": TRAIN + "--config settings.toml", "grid.toml": "sweep grid.toml --out new",
    "palette.txt": TRAIN + "--palette palette.txt --nps-weight 1",
    "triangle.obj": "scene import triangle.obj --out new",
    "triangle.gltf": "scene import triangle.gltf --out new", "run/config.json": RESUME, "run/events.jsonl": RESUME,
    "run/.lock": RESUME, "run/colors.npy": "print run --out new",
}  # fmt: skip


def special_files() -> Iterator[Case]:
    """What is no regular file, in the place of every file that a command reads."""

    def swapped(name: str, make: Callable[[Path], None]) -> Callable[[Path], None]:
        def swap(folder: Path) -> None:
            (folder / name).unlink(missing_ok=True)
            make(folder / name)

        return swap

    for name, line in READ_BY.items():
        for kind, make in SPECIAL.items():
            may = name in ("net.names", "run/.lock", "run/events.jsonl")  # done without
            yield Case(f"{kind} as {name}", swapped(name, make), line, may)


def settings() -> Iterator[Case]:
    bad = {
        "not TOML": "lr = = 1\n",
        "not text": b"\xff\xfe\x00",
        "deep": "lr = " + "[" * 50000,
        "a key of 30,000 parts": "a." * 30000 + "a = 1\n",
        "an integer of 5,000 digits": "batch = " + "9" * 5000 + "\n",
        "a hexadecimal integer of 5,000 digits": "batch = 0x" + "f" * 5000 + "\n",
        "a table": "[lr]\nx = 1\n",
        "a date": "lr = 2020-01-01\n",
        "infinite": "lr = inf\n",
        "a huge number": "batch = 99999999999999999999999999\n",
        "a preset that is a list": "preset = ['best']\n",
        "no angles": "angles = ''\n",
        "10^9 angles": "angles = '0:360:0.0000001'\n",
        "a size of 10^9": "size = 1000000000\n",
        "a device of dots": "device = '../../x'\n",
        "a palette of dots": "palette = '../../../../etc/passwd'\n",
        "large": "# " + "x" * (2 << 20) + "\n",
    }
    line = TRAIN.replace(" --steps 1", "") + "--config bad.toml"
    for name, data in bad.items():
        # What a flag says, too, does not count in the file.
        yield Case(
            f"settings: {name}", put("bad.toml", data), line.replace("--size 32 ", "") if "size" in name else line
        )
    grids = {
        "nothing": "",
        "a pickle": pickle.dumps(Evil()),
        "deep": "[grid]\nlr = " + "[" * 50000,
        "10^10 runs": "[base]\nscene='a'\nlogo='b'\n[grid]\n"
        + "".join(f"{k} = {[*range(1, 100)]}\n" for k in ("seed", "batch", "lr", "steps", "size")),
        "lists within lists": "[base]\nscene='a'\nlogo='b'\n[grid]\nlr = [[1]]\n",
        "a scene outside": "[base]\nscene='../../..'\nlogo='b'\n[grid]\nlr = [1]\n",
    }
    for name, data in grids.items():
        yield Case(f"grid: {name}", put("bad.toml", data), "sweep bad.toml --out new")
    palettes = {"nothing": "", "words": "red\n", "not numbers": "nan nan nan\n", "a pickle": pickle.dumps(Evil())}
    for name, data in palettes.items():
        yield Case(f"palette: {name}", put("bad.txt", data), TRAIN + "--palette bad.txt --nps-weight 1")
