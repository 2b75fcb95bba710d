# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the list of runs: follow one that is running, stop it, delete it."""

from __future__ import annotations

import bpy

from .. import jobs, run_list, runs, steps
from ..blend_paths import absolute
from ..body import active_body
from ..jobs import TrainingJob, require_idle
from ..run_states import FoundTrainer, request_stop
from .base import CloakOperator
from .start_stop import Watch, follow


class CLOAK_OT_run_attach(CloakOperator):
    """Follow a training that this Blender did not start, or lost in a crash: its progress in the panel, its colours \
on the body. When Blender closes it goes on"""

    bl_label = "Attach"
    needs = staticmethod(steps.attach_reason)

    def run(self, context: bpy.types.Context) -> str:
        require_idle()
        obj, run = active_body(context), steps.selected_run(context).path
        face_ids, topology = runs.trained_faces(run)
        runs.require_same_topology(obj, topology)
        watch = Watch(obj, run, face_ids, topology)
        follow(obj, TrainingJob([], run, runs.side_folder(run), watch.finish, FoundTrainer(run)), watch)
        return f"Following {run.name}"


class CLOAK_OT_run_stop(CloakOperator):
    """End the training of the chosen run after its current step, whoever started it; Resume goes on with it"""

    bl_label = "Stop"
    needs = staticmethod(steps.stop_reason)

    def run(self, context: bpy.types.Context) -> str:
        run, job = steps.selected_run(context).path, jobs.current
        if isinstance(job, TrainingJob) and job.running and job.run == run:
            job.cancel()
        else:
            request_stop(run)
        return f"Stopping {run.name} after its current step"


class CLOAK_OT_run_delete(CloakOperator):
    """Delete the folders of the chosen run from the disk; bodies keep the colours they wear. This cannot be undone"""

    bl_label = "Delete Run"
    needs = staticmethod(steps.delete_reason)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context: bpy.types.Context) -> str:
        run = steps.selected_run(context).path
        runs.remove(run)
        for obj in bpy.data.objects:
            if obj.cloak.run and absolute(obj.cloak.run) == str(run):
                obj.cloak.run = ""
        run_list.select(context, None)
        run_list.refresh(context)
        return f"Deleted {run}"


CLASSES = (CLOAK_OT_run_attach, CLOAK_OT_run_stop, CLOAK_OT_run_delete)
