"""The process that reads them: FOLDER FIRST LAST DAMAGED; prints a record for each case."""

import contextlib
import importlib
import io
import json
import os
import resource
import shutil
import sys
import time
import traceback
from pathlib import Path

from cloak_core import cli
from tests.commands.malformed import Case, cases
from tests.commands.malformed.making import GIB


def read_all(root: Path, chosen: list[Case]) -> list[dict]:
    """Run each case's command in this process; one record each: what went wrong, "" for nothing."""
    # What is mapped before the limit does not count: every library that the commands import.
    for name in ("torchvision", "onnxruntime", "trimesh", "xatlas", "matplotlib.pyplot", "torch._dynamo"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for place in cli.COMMANDS.values():
        importlib.import_module(f"cloak_core.commands.{place.partition(':')[0]}")
    importlib.import_module("cloak_core.core.sweeps")
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    limit = int(status["VmSize"].split()[0]) * 1024 + 2 * GIB
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    records = []
    for case in chosen:
        here = root / "case"
        shutil.copytree(root / "sound", here)
        case.make(here)
        os.chdir(here)
        before = {str(path.relative_to(root)) for path in root.rglob("*")}
        out, err, wrong, code = io.StringIO(), io.StringIO(), "", 0
        started = time.perf_counter()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                cli.err.file, cli.out.file = err, out
                cli.main(case.line.split())
        except SystemExit as end:
            code = end.code or 0
        except BaseException:
            wrong = "traceback: " + traceback.format_exc(limit=-3)
        said = err.getvalue()
        made = {str(path.relative_to(root)) for path in root.rglob("*")} - before
        outside = [path for path in made if not path.startswith(("case/new", "case/run", "case/x."))]
        if code not in ((0, 2) if case.may_pass else (2,)) and not wrong:
            wrong = f"exit code {code}: {said}"
        elif code == 2 and (len(said.strip().splitlines()) > 20 or "Traceback" in said):
            wrong = f"not a line: {said[:500]}"
        if any("executed" in path for path in made):
            wrong = "code was executed"
        elif outside:
            wrong = wrong or f"written outside: {outside}"
        print(f"{time.perf_counter() - started:6.1f} s  {case.name}  {wrong[-600:]}", file=sys.stderr, flush=True)
        records.append({"name": case.name, "code": code, "said": said.strip(), "wrong": wrong,
                        "seconds": time.perf_counter() - started})  # fmt: skip
        os.chdir(root)
        shutil.rmtree(here)
    return records


if __name__ == "__main__":
    folder, first, last, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    print(json.dumps(read_all(folder, cases(count)[first:last])))
