"""The command line: finds the command, reads its options with tyro, and turns what happens into words and exit codes.

Exit codes: 0 done, 1 a defect (with its traceback), 2 bad input (one line that names it), 3 stopped in order.
"""

from __future__ import annotations

import errno
import importlib
import json
import os
import sys
from collections.abc import Iterable

from cloak_core import __version__
from cloak_core.commands.base import RANK, Command, err, next_words, out, warn
from cloak_core.commands.streams import kept_for_json, prepare_streams, saying
from cloak_core.files.errors import InputError, Stopped, first_line, one_line, suggestion

GROUPS: dict[str, dict[str, str]] = {
    "Start": {
        "demo": "demo:Demo",
        "train": "train:Train",
        "evaluate": "evaluate:Evaluate",
        "report": "evaluate:Report",
        "setup": "about:Setup",
        "remote": "remote:Remote",
        "zoo list": "zoo:List",
        "zoo show": "zoo:Show",
        "zoo export": "zoo:Export",
        "version": "about:Version",
        "completion": "about:Completion",
    },
    "Bodies, people and logos": {
        "scene sample": "scene:Sample",
        "scene import": "scene:Import",
        "scene import-smpl": "scene:ImportSmpl",
        "scene import-anny": "scene:ImportAnny",
        "scene info": "scene:Info",
        "people fit": "wear:Fit",
        "logo select": "logo:Select",
        "logo project": "logo:Project",
        "logo heatmap": "logo:Heatmap",
        "logo transfer": "logo:Transfer",
    },
    "Measure": {
        "detectors list": "detectors:List",
        "detectors check": "detectors:Check",
        "detectors verify": "detectors:Verify",
        "wear": "wear:Wear",
        "judge": "wear:Judge",
        "film": "film:Film",
        "transfer": "transfer:Transfer",
        "sweep": "sweep:Sweep",
        "export coco": "film:Coco",
    },
    "Defend": {
        "assess": "assess:Assess",
        "leaderboard add": "assess:Add",
        "leaderboard build": "assess:Build",
        "harden": "harden:Harden",
    },
    "Wear and print": {
        "print": "printing:Print",
        "calibrate": "printing:Calibrate",
    },
    "Developers": {
        "reproduce": "reproduce:Reproduce",
        "zoo reproduce": "zoo:Reproduce",
        "zoo add": "zoo:Add",
        "look": "detectors:Look",
        "bench views": "bench:Views",
        "bench accuracy": "bench:Accuracy",
        "bench growth": "bench:Growth",
        "bench stability": "bench:Stability",
        "bench step": "bench:Step",
        "bench gpu": "bench:Gpu",
        "bench detectors": "bench:Detectors",
    },
}
"""Group of the help -> command words -> module:class in cloak_core.commands; imported only when asked for."""
COMMANDS: dict[str, str] = {name: place for group in GROUPS.values() for name, place in group.items()}


def main(arguments: list[str] | None = None) -> None:
    """Run one command and exit."""
    arguments = sys.argv[1:] if arguments is None else arguments
    prepare_streams()
    try:
        command, code, name, options = None, 0, "", []
        with saying():
            try:
                name, options = find(arguments)
                command = parse(name, options)
            except SystemExit as end:  # help or the version was asked for, and is printed
                code = end.code or 0
        sys.exit(run_or_say_usage(command, name, options) if command else code)
    except (Stopped, KeyboardInterrupt) as stop:
        warn(str(stop) or "stopped")
        sys.exit(3)
    except Exception as error:
        words = in_words(error)
        if words is None:
            raise
        complain(words)
        sys.exit(2)


def complain(words: str) -> None:
    """Write one line on standard error, also where no memory is left to make it pretty."""
    try:
        err.print(f"cloak: {words}", style="red")
    except (MemoryError, ImportError):
        os.write(2, f"cloak: {words}\n".encode(errors="backslashreplace"))


def run_or_say_usage(command: Command, name: str, options: list[str]) -> int:
    """Run a command; tell whoever gave no options at all, and some were needed, which there are."""
    try:
        return run(command)
    except InputError as error:
        if set(options) <= {"--json"}:
            from cloak_core.commands.help import usage

            raise InputError(f"{error}; usage: {usage(type(command), name)} (cloak {name} --help)") from None
        raise


def run(command: Command) -> int:
    """Run a command; what it returns goes to standard output as JSON, or as words."""
    if not command.json:
        result = command.run()
        with saying():
            command.show(result)
        if result.get("stopped"):
            raise Stopped(result["stopped"])
        code = _verdict(command, result)
        if not code and not RANK:
            with saying():
                next_words(command, result)
        return code
    with kept_for_json():  # whatever libraries print
        out.file = sys.stderr
        try:
            result = command.run()
        finally:
            out.file = None  # whatever standard output then is
    stopped = result.pop("stopped", None)
    if not RANK:
        with saying():
            print(json.dumps(result, indent=2, allow_nan=False))
    if stopped:
        raise Stopped(stopped)
    return _verdict(command, result)


def _verdict(command: Command, result: dict) -> int:
    """Say what failed; 1 where something did.

    InputError where part of its input was bad, and the rest was done: "refused".
    """
    if result.get("refused"):
        raise InputError(result["refused"])
    failures = command.failures(result)
    for words in failures:
        err.print(f"cloak: {words}", style="red")
    return int(bool(failures))


def find(arguments: list[str]) -> tuple[str, list[str]]:
    """Split the arguments into a known command's words and its options; print help where no command is complete."""
    if arguments[:1] == ["--json"]:
        arguments = [*arguments[1:], "--json"]
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:], "--help"]
    if arguments[:1] == ["--version"]:
        print(json.dumps({"version": __version__}) if "--json" in arguments else __version__)
        sys.exit(0)
    words = " ".join(arguments[:2])
    for name, count in ((words, 2), (words.split(" ")[0], 1)):
        if name in COMMANDS:
            return name, arguments[count:]
    given = [a for a in arguments[:2] if not a.startswith("-")]
    group = {name: place for name, place in COMMANDS.items() if given and name.startswith(given[0] + " ")}
    if given and not group:
        known = dict.fromkeys(name.split()[0] for name in COMMANDS)
        raise InputError(f"unknown command '{given[0]}'{_near(given[0], known)}")
    if len(given) > 1:
        raise InputError(f"unknown command '{words}'{_near(words, group)}")
    print_help(group or COMMANDS)
    sys.exit(0 if {"-h", "--help", "--help-all"} & set(arguments) else 2)


def _near(typed: str, known: Iterable[str]) -> str:
    """Say which command may be meant, or which there are."""
    return suggestion(typed, known) or f" (known: {', '.join(known)})"


def load(name: str) -> type[Command]:
    module, _, cls = COMMANDS[name].partition(":")
    return getattr(importlib.import_module(f"cloak_core.commands.{module}"), cls)


def print_help(commands: dict[str, str]) -> None:
    """Print the help of `cloak`, or of a group of commands such as `cloak scene`."""
    from cloak_core.commands.help import all_commands

    groups = {title: {n: load(n) for n in members if n in commands} for title, members in GROUPS.items()}
    print(all_commands({title: members for title, members in groups.items() if members}), end="")


def parse(name: str, arguments: list[str]) -> Command:
    """Parse the command's options, or print its help."""
    from cloak_core.commands import parsing

    return parsing.parse(load(name), name, arguments)


_FULL_MEMORY = (
    "can't allocate memory",
    "Cannot allocate memory",
    "out of memory",
    "bad_alloc",
    "bad allocation",
    "failed to map segment from shared object",  # the loader, of a module whose file is there
)


def in_words(error: BaseException) -> str | None:
    """Say what to tell the user of an error; None for a defect, whose traceback is to be seen."""
    if isinstance(error, InputError):
        return str(error)
    if memory_is_full(error):
        return f"not enough memory ({one_line(first_line(error))[:160]})"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return one_line(f"{error.filename or 'a file'}: cannot be written ({error.strerror})")
    foreign = sys.modules.get("cloak_core.detectors.foreign_code")
    words = foreign and foreign.culprit(error)
    return one_line(words) if words else None


def memory_is_full(error: BaseException | None) -> bool:
    """Tell whether an error, or one behind it, says that no memory is left: Python's, torch's, the system's."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
            return True
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            return True
        if isinstance(error, (RuntimeError, ImportError)) and any(word in str(error) for word in _FULL_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
