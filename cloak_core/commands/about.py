"""`cloak version` and `cloak completion`: what this is, and how a shell completes it."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from tyro.conf import Positional

from cloak_core import __version__
from cloak_core.commands.base import Command, out


@dataclass(kw_only=True)
class Version(Command):
    """Print the version and those of its parts, for reports of defects."""

    def run(self) -> dict:
        from cloak_core.files.identity import package_versions

        packages = package_versions("torch", "torchvision", "numba", "numpy")
        return {"version": __version__, "python": platform.python_version(), "system": platform.platform()} | packages

    def show(self, result: dict) -> None:
        out.print(f"cloak {result['version']}")
        out.print(", ".join(f"{name} {value}" for name, value in result.items() if name != "version"))


@dataclass(kw_only=True)
class Completion(Command):
    """Print a script with which a shell completes commands and options.

    bash: eval "$(cloak completion bash)" in ~/.bashrc. zsh: the same in ~/.zshrc. fish: cloak completion fish >
    ~/.config/fish/completions/cloak.fish
    """

    example = "bash"

    shell: Positional[Literal["bash", "zsh", "fish"]]
    """bash, zsh or fish."""

    def run(self) -> dict:
        from cloak_core.cli import COMMANDS, load
        from cloak_core.commands.help import flags, summary

        known = {name: (summary(cls.__doc__ or ""), flags(cls)) for name in COMMANDS for cls in [load(name)]}
        lines = _fish(known) if self.shell == "fish" else _bash(known, self.shell)
        return {"shell": self.shell, "script": "\n".join(lines) + "\n"}

    def show(self, result: dict) -> None:
        print(result["script"], end="")


Known = dict[str, tuple[str, dict[str, str]]]
"""Command -> what it does, and its options with what they mean."""


def _bash(known: Known, shell: str) -> Iterator[str]:
    """Yield the lines of a completion function; zsh runs it through its bashcompinit."""
    words = _tree(known)
    if shell == "zsh":
        yield "autoload -U +X compinit && compinit; autoload -U +X bashcompinit && bashcompinit"
    yield "_cloak() {"
    yield '  local current="${COMP_WORDS[COMP_CWORD]}" first="${COMP_WORDS[1]}" second="${COMP_WORDS[2]}" words=""'
    yield '  if [ "$COMP_CWORD" -eq 1 ]; then'
    yield f'    words="{" ".join(words)}"'
    yield '  elif [ "$COMP_CWORD" -eq 2 ] && [[ "$current" != -* ]]; then'
    yield '    case "$first" in'
    for first, inner in words.items():
        yield f'      {first}) words="{" ".join(filter(None, inner))}" ;;'
    yield "    esac"
    yield "  fi"
    yield '  if [[ "$current" == -* ]]; then'
    yield '    case "$first $second" in'
    # Commands of two words stand before those of one, which would match them, too.
    for name in sorted(known, key=lambda name: -name.count(" ")):
        yield f'      "{name}"*) words="{" ".join(known[name][1])}" ;;'
    yield "    esac"
    yield "  fi"
    yield '  COMPREPLY=( $(compgen -W "$words" -- "$current") )'
    yield "}"
    yield "complete -o default -F _cloak cloak"


def _fish(known: Known) -> Iterator[str]:
    for first, inner in _tree(known).items():
        yield f"complete -c cloak -n __fish_use_subcommand -f -a {first} -d {_quoted(inner.get('', f'{first} ...'))}"
        more = {second: about for second, about in inner.items() if second}
        there = f"__fish_seen_subcommand_from {first}; and not __fish_seen_subcommand_from {' '.join(more)}"
        for second, about in more.items():
            yield f"complete -c cloak -n '{there}' -f -a {second} -d {_quoted(about)}"
    for name, (_, options) in known.items():
        there = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in name.split())
        for flag, about in options.items():
            yield f"complete -c cloak -n '{there}' -l {flag.removeprefix('--')} -d {_quoted(about)}"


def _tree(known: Known) -> dict[str, dict[str, str]]:
    """Sort commands by their first words: each has its second words ("" for none), and what they do."""
    words: dict[str, dict[str, str]] = {"help": {"": "Show what a command does and takes"}}
    for name, (about, _) in known.items():
        first, _, second = name.partition(" ")
        words.setdefault(first, {})[second] = about
    return words


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
