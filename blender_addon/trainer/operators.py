# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that find, test and install the trainer."""

from pathlib import Path

import bpy

from ..body.objects import refusal
from ..files.errors import InputError
from ..session import session
from ..translations import said
from ..ui import props
from ..ui.operator import CloakOperator
from . import install, jobs
from .install import Base, InstallJob
from .jobs import Job, last_words, launch
from .preferences import CLICK_SECONDS, INSTALLATION, chosen_python, local_python, preferences, use_python, user_folder
from .python import INSTALL_LINE, Question, about_command, forget_answers, parse_about

_bases: dict[str, Question] = {}  # Pythons that were asked whether they can make environments, by what was chosen
OFFLINE = "Blender's online access is off: Preferences > System > Network > Allow Online Access"


class CLOAK_OT_find_python(CloakOperator, label="Find Python"):
    """Look for a Python that has cloak_core"""

    def run(self, context: bpy.types.Context) -> str:
        forget_answers()
        preferences().python = python = local_python("")
        return f"Trainer's Python: {python}"


class CLOAK_OT_test_python(CloakOperator, label="Test Trainer", needs=lambda context: jobs.busy()):
    """Start the trainer and show its version and device"""

    def run(self, context: bpy.types.Context) -> str:
        python = chosen_python()
        preferences().answer = "Starting the trainer..."
        answer = lambda job: _say(refusal(describe_trainer, python, job) or describe_trainer(python, job))
        launch(Job("Test", [about_command(python)], user_folder("test"), "test", answer))
        return "Testing the trainer: the answer appears in the preferences"


class CLOAK_OT_copy_install_line(CloakOperator, label="Copy Installation Line"):
    """Copy the line that installs the trainer to the clipboard"""

    def run(self, context: bpy.types.Context) -> str:
        context.window_manager.clipboard = INSTALL_LINE
        return "Copied: paste it into a terminal in the folder of Cloak's sources"


def describe_trainer(python: str, job: Job) -> str:
    """One line about a trainer, from what `about_command` said last; `InputError` where it does not work."""
    facts = parse_about(python, job.state == "done", "".join(job.outputs[-1:]), last_words(job.log))
    return f"Cloak {facts['cloak']}, torch {facts['torch']}, Python {facts['python']}, {facts['device']}"


def _say(answer: str) -> str:
    preferences().answer = answer
    return answer


def trainer_folder() -> Path:
    """Where environments are made."""
    return user_folder("trainer")


def _base(chosen: str, seconds: float) -> Base:
    """Return the Python that makes the environment; it is queried in a thread, so that Blender does not freeze."""
    if chosen not in _bases:
        _bases[chosen] = Question(lambda: install.find_base(chosen))
    question = _bases[chosen]
    question.join(seconds)
    if question.answer is None:
        raise InputError("Still looking for a Python to install with: try again in a moment")
    del _bases[chosen]
    if isinstance(question.answer, InputError):
        raise question.answer
    return question.answer


class CLOAK_OT_install_trainer(CloakOperator, label="Install Trainer"):
    """Install the trainer into the add-on's own folder: an environment of its own, filled by pip from your package \
index. Asks first, and says how much it takes"""

    python: props.path("Python", "Python that makes the environment; empty to look for one", relative=False)
    share_torch: props.switch(
        "Use Its Torch", "Let the trainer use the torch that this Python has already, instead of another 5 GB", True
    )

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        if not bpy.app.online_access:
            return OFFLINE
        try:
            install.find_source(preferences().source)
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
        for text, icon in (
            (f"Takes about {install.gigabytes(self._found, self.share_torch):g} GB and some minutes", "INFO"),
            (f"Into: {trainer_folder()}", "FILE_FOLDER"),
            (f"What: {install.find_source(preferences().source).name}", "PACKAGE"),
            ("And what it needs, by pip from your package index", "BLANK1"),
            (f"By: {self._found.describe()}", "CONSOLE"),
        ):
            column.label(text=said(text), icon=icon)
        if self._found.torch:
            self.layout.prop(self, "share_torch", text=said(f"Use the torch {self._found.torch} of this Python"))

    def run(self, context: bpy.types.Context) -> str:
        base, source, folder = _base(self.python, 60), install.find_source(preferences().source), trainer_folder()
        install.require_room(folder, install.gigabytes(base, self.share_torch))
        # One that works stays until the next one does.
        place = next(place for place in (folder / str(number) for number in range(1, 10_000)) if not place.exists())
        (folder / "install.log").write_bytes(b"")
        commands = install.install_commands(base, place, source, self.share_torch)
        launch(InstallJob(INSTALLATION, commands, folder, "install", lambda job: _ended(job, place)))
        return f"Installing the trainer into {place}"


def _ended(job: InstallJob, place: Path) -> str:
    """Use what was installed, or take away what is left of it, and say why."""
    folder, python = trainer_folder(), install.python_in(place)
    if not job.complete:
        install.sweep(folder, _in_use(folder))
        if job.state != "failed":
            job.state = "stopped"
            return "Installation cancelled: nothing of it is left"
        words = install.diagnosis(job.everything(), job.message)
        return _say(f"The trainer was not installed. {words} (log: {job.log})")
    if refused := refusal(describe_trainer, python, job):
        install.sweep(folder, _in_use(folder))
        job.state = "failed"
        return _say(refused)
    use_python(python)
    install.sweep(folder, place)
    return _say(describe_trainer(python, job))


def _in_use(folder: Path) -> Path | None:
    """The environment whose Python is chosen now."""
    kept = Path(preferences().python)
    return folder / kept.relative_to(folder).parts[0] if kept.is_relative_to(folder) else None


class CLOAK_OT_show_install_log(CloakOperator, label="Show Log"):
    """Open what was said while the trainer was installed as a text in Blender"""

    @staticmethod
    def needs(context: bpy.types.Context) -> str:
        return "" if isinstance(session.job, InstallJob) else "Nothing was installed since Blender started"

    def run(self, context: bpy.types.Context) -> str:
        text = bpy.data.texts.get("Cloak installation") or bpy.data.texts.new("Cloak installation")
        text.from_string(session.job.everything())
        return f"The log is the text '{text.name}' of the Text Editor"
