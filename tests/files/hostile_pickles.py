"""Makes hostile pickles by structure and reads each in a process of its own, under a memory limit.

    python -m tests.files.hostile_pickles torch|arrays [COUNT [SECONDS_EACH]]

prints {"files", "read", "refused", "slowest_s"} as JSON, and fails at the first file that is answered by anything but
values or an InputError, or that takes too long; that file stays (hostile.bin).
"""

import io
import json
import os
import resource
import struct
import sys
import time
import traceback
import zipfile
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from cloak_core.files.errors import InputError
from cloak_core.files.torch_pickles import read_torch_pickle
from cloak_core.files.unpickling import read_pickled_arrays

MEMORY_BYTES = 2 << 30
BATCH = 100
SETTINGS = settings(
    max_examples=BATCH,
    database=None,
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
REFUSED = 3
NAMES = [
    ("numpy", "ndarray"), ("numpy", "dtype"), ("numpy.core.multiarray", "_reconstruct"), ("_codecs", "encode"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"), ("builtins", "object"),
    ("copyreg", "_reconstructor"), ("scipy.sparse", "csc_matrix"), ("scipy.sparse", "csr_matrix"), ("chumpy.ch", "Ch"),
    ("chumpy.reordering", "Select"), ("collections", "OrderedDict"), ("builtins", "set"), ("torch", "Size"),
    ("torch._utils", "_rebuild_tensor_v2"), ("torch._utils", "_rebuild_parameter"), ("torch", "FloatStorage"),
    ("torch.nn.modules.conv", "Conv2d"), ("builtins", "getattr"), ("torch", "BFloat16Storage"), ("posix", "system"),
]  # fmt: skip
INTEGERS = [0, 1, 2, 3, 4, 7, 255, 1 << 16, 1 << 20, (1 << 29) - 1, (1 << 31) - 1, -1, 1 << 40, 1 << 62, -(1 << 63)]
CODES = ["f4", "f8", "i8", "u1", "O", "O8", "V8", "V", "U9999", "S0", "M8[s]", "(1000,1000)f8", "f4,f4", "<f4", "g"]
CODES += ["b1"]


def integer(value: int) -> bytes:
    data = value.to_bytes((value.bit_length() + 8) // 8, "little", signed=True)
    return b"\x8a" + bytes([len(data)]) + data


def text(value: str) -> bytes:
    data = value.encode()
    return b"X" + struct.pack("<I", len(data)) + data


def name(pair: tuple[str, str]) -> bytes:
    return b"c" + "\n".join(pair).encode() + b"\n"


def tuple_of(parts: list[bytes]) -> bytes:
    return b"(" + b"".join(parts) + b"t"


integers = st.one_of(st.sampled_from(INTEGERS), st.integers(-(1 << 70), 1 << 70)).map(integer)
small = st.integers(0, 9).map(integer)
sizes = st.one_of(small, integers)
data = st.one_of(st.binary(max_size=64), st.integers(0, 1 << 16).map(bytes)).map(
    lambda value: b"B" + struct.pack("<I", len(value)) + value
)
texts = st.one_of(st.text(max_size=8), st.sampled_from(["latin1", "storage", "cpu", "<", ">", "|", "0", "1"])).map(text)
shapes = st.lists(sizes, max_size=5).map(tuple_of)
names = st.sampled_from(NAMES).map(name)
# Its state may call numbers objects and objects numbers: (3, "|", None, None, None, size, alignment, flags).
dtype_states = st.lists(st.one_of(sizes, texts, st.just(b"N"), shapes), max_size=8).map(tuple_of)
dtypes = st.builds(
    lambda code, state: name(("numpy", "dtype")) + tuple_of([text(code), b"K\0", b"K\1"]) + b"R" + state,
    st.sampled_from(CODES),
    st.one_of(
        st.just(b""),
        st.just(
            tuple_of([b"K\3", text("|"), b"N", b"N", b"N", b"J\xff\xff\xff\xff", b"J\xff\xff\xff\xff", b"K\0"]) + b"b"
        ),
        st.sampled_from(["<", ">", "|"]).map(lambda o: tuple_of([b"K\3", text(o), b"N", b"N", b"N", b"K\1"]) + b"b"),
        dtype_states.map(lambda state: state + b"b"),
    ),
)
empty = tuple_of([name(("numpy", "ndarray")), tuple_of([b"K\0"]), b"C\1b"])
unfilled_bytes = name(("numpy.core.multiarray", "_reconstruct")) + empty + b"R"
unfilled = st.sampled_from(["core", "_core"]).map(
    lambda core: name((f"numpy.{core}.multiarray", "_reconstruct")) + empty + b"R"
)


def extents(count: int) -> bytes:
    return tuple_of([integer(count)])


states_of_bytes = tuple_of(
    [b"K\1", extents(4), name(("numpy", "dtype")) + tuple_of([text("u1")]) + b"R", b"\x89", b"C\4" + bytes(4)]
)

right = st.integers(0, 300).map(
    lambda n: tuple_of([
        b"K\1", extents(n), name(("numpy", "dtype")) + tuple_of([text("f8")]) + b"R", b"\x89",
        b"B" + struct.pack("<I", 8 * n) + bytes(8 * n),
    ])
)  # fmt: skip
states = st.one_of(right, st.tuples(small, shapes, dtypes, small, st.one_of(data, texts)).map(lambda p: tuple_of([*p])))
arrays = st.builds(
    lambda made, state, more: made + state + b"b" + more, unfilled, states, st.sampled_from([b"", b"K\1b"])
)
twice = st.builds(lambda made, one, two: made + one + b"b" + two + b"b", unfilled, right, right)
storages = st.builds(
    lambda kind, key, count: tuple_of([text("storage"), kind, text(key), text("cpu"), count]) + b"Q",
    names, st.sampled_from(["0", "1", "2", "../data.pkl", "", "0" * 5000]), sizes,
)  # fmt: skip
tensors = st.builds(
    lambda storage, offset, shape, strides: (
        name(("torch._utils", "_rebuild_tensor_v2")) + tuple_of([storage, offset, shape, strides, b"\x89", b"N"]) + b"R"
    ),
    st.one_of(storages, arrays), sizes, shapes, shapes,
)  # fmt: skip
memory = st.builds(
    lambda kind, index: (b"r" if kind else b"j") + struct.pack("<I", index), st.booleans(),
    st.one_of(st.integers(0, 4), st.sampled_from([1 << 20, 1 << 29, (1 << 32) - 1])),
)  # fmt: skip
lengths = st.builds(
    lambda code, length: code + struct.pack("<Q" if code in (b"\x8e", b"\x8d", b"\x95", b"\x96") else "<I", length),
    st.sampled_from([b"\x8e", b"\x8d", b"\x95", b"\x96", b"B", b"X", b"T", b"\x8b"]),
    st.sampled_from([0, 1, 100, 1 << 20, (1 << 31) - 1]),
) | st.just(b"\x8e" + struct.pack("<Q", 1 << 62))  # fmt: skip
BOMBS = {
    "tuples in tuples as a key": lambda n: b"}" + b")" + b"2\x86" * min(n, 60) + b"K\1s",
    "tuples in tuples in a set": lambda n: name(("builtins", "set")) + b"])" + b"2\x86" * min(n, 60) + b"a\x85R",
    "tuples in tuples as indices": lambda n: (
        name(("chumpy.reordering", "Select")) + b")\x81}(" + text("a") + unfilled_bytes + states_of_bytes + b"b"
        + text("idxs") + b")" + b"2\x86" * min(n, 60) + b"ub"
    ),
    "integers that share a hash": lambda n: b"}" + b"".join(integer(k * ((1 << 61) - 1)) + b"K\1s" for k in range(n)),
    "a text encoded over and over": lambda n: (
        b"X" + struct.pack("<I", 1 << 16) + b"x" * (1 << 16) + b"q\0]q\1"
        + (name(("_codecs", "encode")) + b"h\0" + text("latin1") + b"\x86Ra") * n
    ),
    "one array's bytes for many": lambda n: (
        b"B" + struct.pack("<I", 1 << 17) + bytes(1 << 17) + b"q\0]q\1"
        + (
            name(("numpy.core.multiarray", "_reconstruct")) + empty + b"R("
            + b"K\1" + extents(1 << 17) + name(("numpy", "dtype")) + tuple_of([text("u1")]) + b"R\x89h\0tba"
        ) * n
    ),
    "a class each": lambda n: b"]" + b"".join(name(("torch.nn", f"C{k}")) + b"a" for k in range(n)),
    "lists in lists": lambda n: b"]" * n + b"a" * (n - 1),
    "empty sets": lambda n: b"(" + b"\x8f" * n + b"l",
    "one number as many": lambda n: (
        name(("torch._utils", "_rebuild_tensor_v2"))
        + tuple_of([
            tuple_of([text("storage"), name(("torch", "FloatStorage")), text("0"), text("cpu"), b"K\1"]) + b"Q", b"K\0",
            tuple_of([integer(1 << 20), integer(n)]), tuple_of([b"K\0", b"K\0"]),
        ]) + b"R"
    ),
    "a sparse matrix of nothing": lambda n: (
        name(("scipy.sparse", "csc_matrix")) + b")\x81}(" + text("_shape") + tuple_of([integer(n), integer(1 << 14)])
        + text("indptr") + b"]" + text("indices") + b"]" + text("data") + b"]ub"
    ),
}  # fmt: skip
bombs = st.builds(
    lambda kind, n: BOMBS[kind](n), st.sampled_from(sorted(BOMBS)), st.sampled_from([1, 50, 2000, 20_000, 60_000])
)
states_of_records = st.lists(st.tuples(texts | st.sampled_from(
    ["x", "a", "idxs", "indptr", "indices", "data", "_shape", "shape", "preferred_shape", "_modules", "_parameters"]
).map(text), st.one_of(arrays, tensors, shapes, small, memory)), max_size=6)  # fmt: skip
records = st.builds(
    lambda kind, made, state: kind + made + b"}(" + b"".join(k + v for k, v in state) + b"ub",
    names, st.sampled_from([b")\x81", b")R"]), states_of_records,
)  # fmt: skip
calls = st.builds(
    lambda function, arguments: function + tuple_of(arguments) + b"R", names,
    st.lists(st.one_of(integers, texts, data, dtypes, shapes, names, memory), max_size=5),
)  # fmt: skip
stray = st.binary(min_size=1, max_size=3)
fragments = st.one_of(arrays, twice, tensors, records, calls, bombs, memory, lengths, dtypes, stray, integers, storages)


@st.composite
def pickles(draw: st.DrawFn) -> bytes:
    """A dictionary whose values are fragments; some of its bytes turned over, or cut off."""
    parts = draw(st.lists(fragments, min_size=1, max_size=8))
    put = draw(st.booleans())
    whole = b"\x80\x02}" + b"".join(
        text(f"k{i}") + part + (b"q" + bytes([i]) if put else b"") + b"s" for i, part in enumerate(parts)
    )
    whole += b"."
    for _ in range(draw(st.sampled_from([0, 0, 0, 1, 3]))):
        place = draw(st.integers(0, len(whole) - 1))
        whole = whole[:place] + draw(st.binary(min_size=1, max_size=1)) + whole[place + 1 :]
    return whole[: draw(st.integers(0, len(whole)))] if draw(st.integers(0, 9)) == 0 else whole


@st.composite
def archives(draw: st.DrawFn) -> bytes:
    """What torch.save would have written around a pickle, or nearly."""
    buffer = io.BytesIO()
    method = draw(st.sampled_from([zipfile.ZIP_STORED] * 4 + [zipfile.ZIP_DEFLATED]))
    with zipfile.ZipFile(buffer, "w", method) as archive:
        folder = draw(st.sampled_from(["a/", "archive/", "", "../"]))
        archive.writestr(f"{folder}data.pkl", draw(pickles()))
        if draw(st.integers(0, 3)) == 0:
            archive.writestr(f"{folder}byteorder", draw(st.sampled_from([b"little", b"big", b""])))
        for key in range(draw(st.integers(0, 3))):
            archive.writestr(f"{folder}data/{key}", bytes(draw(st.sampled_from([0, 4, 64, 1 << 16, 1 << 20]))))
    whole = buffer.getvalue()
    for _ in range(draw(st.sampled_from([0, 0, 0, 1, 2]))):
        place = draw(st.integers(max(0, len(whole) - 400), len(whole) - 1))
        whole = whole[:place] + draw(st.binary(min_size=1, max_size=1)) + whole[place + 1 :]
    return whole


def outcome(read: Callable[[Path], object], path: Path) -> str:
    """ "read" or "refused", found by a child under the memory limit. AssertionError: any other end of it."""
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            read(path)
        except InputError as error:
            os._exit(REFUSED if "\n" not in str(error) else 1)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert ended in (0, REFUSED), f"{path}: ended with {ended}"
    return "refused" if ended else "read"


def read_all(kind: str, count: int, seconds_each: float) -> dict[str, object]:
    """Read so many hostile files. AssertionError: one took too long, or ended in anything but values or InputError."""
    read = {"torch": read_torch_pickle, "arrays": read_pickled_arrays}[kind]
    path, counts = Path("hostile.bin"), {"files": 0, "read": 0, "refused": 0, "slowest_s": 0.0}
    files = archives() | pickles() if kind == "torch" else pickles()

    def attempt(content: bytes) -> None:
        if counts["files"] == count:
            return
        path.write_bytes(content)
        start, counts["files"] = time.perf_counter(), counts["files"] + 1
        counts[outcome(read, path)] += 1
        seconds = time.perf_counter() - start
        counts["slowest_s"] = max(counts["slowest_s"], round(seconds, 3))
        assert seconds <= seconds_each, f"{seconds:.1f} s"

    # Hypothesis keeps what it drew until the end of a test.
    for batch in range(-(-count // BATCH)):
        given_files = given(files)(attempt)
        seed(batch)(settings(SETTINGS)(given_files))()
    return counts


if __name__ == "__main__":
    which, *more = sys.argv[1:]
    print(json.dumps(read_all(which, int(more[0]) if more else 2000, float(more[1]) if len(more) > 1 else 3.0)))
