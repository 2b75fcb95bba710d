"""`cloak look`: one view of a body, and what detectors make of it; or one after the other, for a program that asks."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from cloak_core.commands.base import out, warn
from cloak_core.commands.options import Detecting
from cloak_core.files.errors import InputError

if TYPE_CHECKING:
    from cloak_core.studies.look import Looker

MAX_LINE = 1 << 16
"""Characters of a request."""


@dataclass(kw_only=True)
class Look(Detecting):
    """Render a body from one camera and say where detectors see a person."""

    example = "request.json --detector builtin"

    request: Positional[Path]
    """JSON: scene, out (a folder), and any of logo, colors, cloth, pose, outfit, azimuth, elevation, distance,
    field_of_view, pivot, width, height, backgrounds, background. -: one such object a line from standard input; answers
    go to OUT/look.json."""
    detector: UseAppendAction[tuple[str, ...]] = ()
    """Detectors to look with; builtin where none is named."""

    def run(self) -> dict:
        self.prepare()
        from cloak_core.files.reading import read_json
        from cloak_core.studies.look import Look, Looker

        asked = None if self.request == Path("-") else Look.of(read_json(self.request))
        looker = Looker(self.by_spec(self.detector or ("builtin",)))
        return {"looks": answer_lines(looker)} if asked is None else looker.look(asked)

    def show(self, result: dict) -> None:
        for spec, told in result.get("detectors", {}).items():
            for name, seen in ((name, seen) for name, seen in told.items() if isinstance(seen, dict)):
                found = "found" if seen["max_person"] > told["operating_point"] else "hidden"
                out.print(f"{spec}: {name} {found}, best score {seen['max_person']:.3f}")
        if "looks" in result:
            out.print(f"{result['looks']} looks")


def answer_lines(looker: Looker) -> int:
    """Answer the requests of standard input, one a line; how many there were."""
    from cloak_core.files.reading import parse_json
    from cloak_core.files.writing import write_json
    from cloak_core.studies.look import ANSWER, Look

    count = 0
    while line := sys.stdin.readline(MAX_LINE):
        count += bool(line.strip())
        record: dict = {}
        try:
            if line.strip():
                record = parse_json(line.encode(), f"request {count}")
                looker.look(Look.of(record))
        except InputError as error:
            warn(str(error))
            place = record.get("out")  # where the answer is waited for
            if isinstance(place, str) and Path(place).is_dir():
                write_json(Path(place) / ANSWER, {"error": str(error)})
    return count
