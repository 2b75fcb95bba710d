# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the list of runs: follow one that is running, stop it, delete it."""

from __future__ import annotations

import bpy

from ..files.errors import InputError
from ..session import session
from ..trainer.jobs import TrainingJob
from ..ui.operator import CloakOperator
from . import run_list, runs
from .operators import Watch, follow
from .reasons import attach_reason, delete_reason, selected_run, stop_reason
from .run_states import FoundTrainer, request_stop
from .runs import run_of


class CLOAK_OT_run_attach(CloakOperator):
    """Follow a training that this Blender did not start, or lost in a crash: its progress in the panel, its colours \
on the body. When Blender closes it goes on"""

    bl_label = "Attach"
    needs = staticmethod(attach_reason)

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        face_ids, topology = runs.trained_faces(run)
        obj = runs.body_of(run, topology)
        if obj is None:
            raise InputError(f"No body of this file has the faces that {run.name} is trained on: open its own file")
        context.view_layer.objects.active = obj
        watch = Watch(obj, run, face_ids, topology)
        follow(obj, TrainingJob([], run, runs.side_folder(run), watch.finish, FoundTrainer(run)), watch)
        return f"Following {run.name}"


class CLOAK_OT_run_stop(CloakOperator):
    """End the training of the chosen run after its current step, whoever started it; Resume goes on with it"""

    bl_label = "Stop"
    needs = staticmethod(stop_reason)

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        mine = [job for job in session.jobs if isinstance(job, TrainingJob) and job.active and job.run == run]
        for job in mine:
            job.cancel()
        if not mine:
            request_stop(run)
        return f"Stopping {run.name} after its current step"


class CLOAK_OT_run_delete(CloakOperator):
    """Delete the folders of the chosen run from the disk; bodies keep the colours they wear. This cannot be undone"""

    bl_label = "Delete Run"
    needs = staticmethod(delete_reason)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context: bpy.types.Context) -> str:
        run = selected_run(context).path
        runs.remove(run)
        for obj in bpy.data.objects:
            if run_of(obj) == run:
                obj.cloak.run = ""
        run_list.select(context, None)
        run_list.refresh(context)
        return f"Deleted {run}"
