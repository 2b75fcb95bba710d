# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators that install the trainer into the extension's own folder."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..files.errors import InputError
from ..session import session
from ..translations import said
from ..ui.operator import CloakOperator
from . import install as trainer_install
from . import jobs
from .install import Base, InstallJob
from .jobs import last_words, launch, require_idle
from .preferences import CLICK_SECONDS, describe_trainer, preferences, use_python, user_folder
from .python import Question

_bases: dict[str, Question] = {}
"""Pythons that were asked whether they can make environments, by what was chosen."""
OFFLINE = "Blender's online access is off: Preferences > System > Network > Allow Online Access"


def trainer_folder() -> Path:
    """Where environments are made."""
    return user_folder("trainer")


def _base(chosen: str, seconds: float) -> Base:
    """The Python that will make the environment; asked in a thread, so that a slow one freezes nobody."""
    question = _bases.setdefault(chosen, Question(lambda: _asked(chosen)))
    question.join(seconds)
    if question.answer is None:
        raise InputError("Still looking for a Python to install with: try again in a moment")
    del _bases[chosen]
    if isinstance(question.answer, InputError):
        raise question.answer
    return question.answer


def _asked(chosen: str) -> Base | InputError:
    try:
        return trainer_install.find_base(chosen)
    except InputError as error:
        return error


class CLOAK_OT_install_trainer(CloakOperator):
    """Install the trainer into the add-on's own folder: an environment of its own, filled by pip from your package \
index. Asks first, and says how much it takes"""

    bl_label = "Install Trainer"

    python: StringProperty(
        name="Python", description="Python that makes the environment; empty to look for one", subtype="FILE_PATH"
    )
    share_torch: BoolProperty(
        name="Use Its Torch",
        description="Let the trainer use the torch that this Python has already, instead of another 5 GB",
        default=True,
    )

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        if not bpy.app.online_access:
            return OFFLINE
        kept = preferences()
        try:
            trainer_install.find_source(kept.source if kept else "")
        except InputError as error:
            return f"{error} (in the add-on's preferences)"
        return jobs.busy()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.attempt(self._ask, context)

    def _ask(self, context: bpy.types.Context) -> set[str]:
        self._found = _base(self.python, 10 * CLICK_SECONDS)
        self.python = self._found.python
        return context.window_manager.invoke_props_dialog(self, width=460, confirm_text="Install")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        size = trainer_install.gigabytes(self._found, self.share_torch)
        kept = preferences()
        source = trainer_install.find_source(kept.source if kept else "")
        for text, icon in (
            (f"Takes about {size:g} GB and some minutes", "INFO"),
            (f"Into: {trainer_folder()}", "FILE_FOLDER"),
            (f"What: {source.name}", "PACKAGE"),
            ("And what it needs, by pip from your package index", "BLANK1"),
            (f"By: {self._found.describe()}", "CONSOLE"),
        ):
            column.label(text=said(text), icon=icon)
        if self._found.torch:
            self.layout.prop(self, "share_torch", text=said(f"Use the torch {self._found.torch} of this Python"))

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        kept = preferences()
        base = _base(self.python, 60)
        source = trainer_install.find_source(kept.source if kept else "")
        folder = trainer_folder()
        trainer_install.require_room(folder, trainer_install.gigabytes(base, self.share_torch))
        place = trainer_install.next_place(folder)
        (folder / "install.log").write_bytes(b"")
        commands = trainer_install.install_commands(base, place, source, self.share_torch)
        job = InstallJob(trainer_install.LABEL, commands, folder, "install", lambda job: _ended(job, place))
        launch(job)
        return f"Installing the trainer into {place}"


def _ended(job: InstallJob, place: Path) -> str:
    """Use what was installed, or take away what is left of it, and say why."""
    if not job.complete:
        _sweep_but(_in_use())
        if job.state != "failed":
            job.state = "stopped"
            return "Installation cancelled: nothing of it is left"
        words = trainer_install.diagnosis(job.everything(), job.message)
        return _say(f"The trainer was not installed. {words} (log: {job.log})")
    python = trainer_install.python_in(place)
    try:
        answer = describe_trainer(python, True, job.outputs[-1], last_words(job.log))
    except InputError as error:
        _sweep_but(_in_use())
        job.state = "failed"
        return _say(str(error))
    use_python(python)
    _sweep_but(place)
    return _say(answer)


def _say(answer: str) -> str:
    kept = preferences()
    if kept:
        kept.answer = answer
    return answer


def _in_use() -> Path | None:
    """The environment whose Python is chosen now."""
    kept, folder = preferences(), trainer_folder()
    inside = kept and Path(kept.python).is_relative_to(folder)
    return folder / Path(kept.python).relative_to(folder).parts[0] if inside else None


def _sweep_but(keep: Path | None) -> None:
    trainer_install.sweep(trainer_folder(), keep)


class CLOAK_OT_show_install_log(CloakOperator):
    """Open what was said while the trainer was installed as a text in Blender"""

    bl_label = "Show Log"

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return "" if isinstance(session.job, InstallJob) else "Nothing was installed since Blender started"

    def run(self, context: bpy.types.Context) -> str:
        text = bpy.data.texts.get("Cloak installation") or bpy.data.texts.new("Cloak installation")
        text.from_string(session.job.everything())
        return f"The log is the text '{text.name}' of the Text Editor"
