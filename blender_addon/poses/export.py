# SPDX-License-Identifier: GPL-3.0-or-later
"""From a Blender scene to the trainer's files: a scene package and a face list.

The body's polygons come first and keep their indices, so a logo's face ids mean the same on both sides; clothing
follows them, and may wear the logo too. Polygons are triangulated once, in the first pose. Where modifiers give an
object other faces, its triangles are exported as evaluated and its faces as its own (see `modifiers`).
"""

from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
import numpy as np

from ..blender import colors
from ..blender.evaluated import carried_faces, changes_faces, keeps_faces, modifiers_reason, numbered_faces
from ..blender.faces import logo_mask, logo_names, require_logo
from ..blender.mesh_arrays import evaluated_mesh, mesh_triangles, polygon_loops, to_world, topology, vertex_points
from ..body.garments import Garment, worn_by
from ..body.objects import active_body, of_the_body, refusal, require_body, require_upright, scene_axes
from ..exchange.bodies import Bodies
from ..exchange.face_lists import write_face_list
from ..exchange.scenes import write_scene
from ..files.errors import InputError
from ..files.identity import sha256_arrays, sha256_record
from ..files.reading import read_json
from ..files.writing import new_folder, write_json
from ..properties import pose_choice
from ..ui.window import progress_cursor, show_progress
from .poses import PoseChoice, first_frame, list_poses, require_faces, require_own_animation, require_size, visit

RECORD = "export.json"


@dataclass(frozen=True)
class Part:
    """One evaluated object: what is the same in all its poses."""

    vertex_count: int
    loop_total: np.ndarray
    loop_vertices: np.ndarray
    own_face: np.ndarray | None
    """[P] the face of the mesh that each evaluated polygon counts as; None where each is one of its own."""
    triangles: np.ndarray
    triangle_face: np.ndarray

    @property
    def face_count(self) -> int:
        """Number of faces; polygons that modifiers add are counted after the mesh's own."""
        return len(self.loop_total) if self.own_face is None else int(self.own_face.max()) + 1


@of_the_body
def poses_reason(context: bpy.types.Context, obj: bpy.types.Object, choice: PoseChoice | None = None) -> str:
    """Why the given poses (by default those of step 3) cannot be exported."""
    choice = choice or pose_choice(context.scene.cloak)
    reason = refusal(require_upright, obj) or refusal(require_faces, obj) or refusal(require_size, obj)
    reason = reason or refusal(list_poses, obj, choice)
    return reason or refusal(require_own_animation, [obj, *worn_by(obj)], choice) or modifiers_reason(obj)


def standing_reason(context: bpy.types.Context) -> str:
    """Why the body cannot be exported as it stands."""
    return poses_reason(context, PoseChoice())


def export_summary(context: bpy.types.Context) -> str:
    """What will be exported, counted."""
    obj, settings = active_body(context), context.scene.cloak
    poses = len(list_poses(obj, pose_choice(settings)))
    text = f"{poses} pose{'s' * (poses != 1)} of {len(obj.data.polygons):,} faces"
    worn = {o.name: obj.cloak.logo in logo_names(o.data) for o in worn_by(obj)}
    text += f", with {', '.join(worn)}" if worn else ""
    too = [name for name, wears_it in worn.items() if wears_it]
    return text + (f"; the logo goes on over {', '.join(too)}" if too else "")


def export_bodies(
    context: bpy.types.Context, obj: bpy.types.Object, choice: PoseChoice, logo: str = ""
) -> tuple[Bodies, list[Garment]]:
    """Body and clothing in every chosen pose, and the clothing that wears the logo too, face by face as the body.

    Leaves the scene as it was.
    """
    require_body(obj)
    clothing = worn_by(obj)
    objects = [obj, *clothing]
    for one in objects:
        require_upright(one)
    require_size(obj)
    wearing = [obj, *(o for o in clothing if logo and logo_mask(o, logo).any())]
    require_own_animation(objects, choice)
    poses = list_poses(obj, choice)
    parts: list[Part | None] = [None] * len(objects)
    vertices: list[np.ndarray] = []
    play_from = first_frame(context.scene, objects)
    # Detector's Eye exports one pose again and again, which the pointer need not tell.
    pointer = progress_cursor() if len(poses) > 1 else nullcontext()
    with visit(context, obj, play_from) as go, pointer:
        go(poses[0])
        graph = context.evaluated_depsgraph_get()
        with numbered_faces([o for o in wearing if changes_faces(o, graph)]):
            for done, pose in enumerate(poses):
                show_progress(done / len(poses))
                go(pose)
                graph = context.evaluated_depsgraph_get()
                evaluated = [_evaluate(o, graph, o in wearing, part) for o, part in zip(objects, parts, strict=True)]
                vertices.append(np.concatenate([points for points, _ in evaluated]))
                parts = [part for _, part in evaluated]
    body = [_filled_up(outfit, parts[0].face_count) for outfit in colors.own_outfits(obj)]
    worn = [_outfits(o, part, len(body)) for o, part in zip(clothing, parts[1:], strict=True)]
    outfits = np.stack([np.concatenate(together) for together in zip(body, *worn, strict=True)])
    names = tuple(pose.name for pose in poses)
    looks = {"vertices": np.stack(vertices), "face_colors": outfits, "names": names, "name": obj.name}
    try:
        bodies = Bodies(**looks, **_joined(parts, [topology(o) for o in wearing]))
    except InputError as error:
        raise InputError(f"'{obj.name}': {error}") from None
    starts = np.cumsum([0, *(part.face_count for part in parts)]).tolist()
    dressed = ((o, start) for o, start in zip(objects, starts, strict=False) if o in wearing[1:])
    return bodies, [Garment(o.name, start, len(o.data.polygons), topology(o)) for o, start in dressed]


def _evaluate(
    obj: bpy.types.Object, graph: bpy.types.Depsgraph, by_own_face: bool, before: Part | None
) -> tuple[np.ndarray, Part]:
    """Vertices [V, 3] in scene axes and metres, and the rest, which was so before; `InputError` where it changed."""
    with evaluated_mesh(obj, graph) as (mesh, matrix):
        world = to_world(vertex_points(mesh), matrix) * graph.scene.unit_settings.scale_length
        points = scene_axes(world).astype(np.float32)
        loops = polygon_loops(mesh)
        if before is not None:
            same = map(np.array_equal, loops, (before.loop_total, before.loop_vertices))
            if len(points) == before.vertex_count and all(same):
                return points, before
            raise InputError(f"The faces of '{obj.name}' change from pose to pose: turn off its modifiers, or hide it")
        triangles, face = mesh_triangles(mesh)
        own = None
        if by_own_face and not keeps_faces(obj, mesh):
            own = carried_faces(obj, mesh)
            # Polygons of no own face get numbers behind the mesh's last.
            own = np.where(own < 0, len(obj.data.polygons) + np.cumsum(own < 0) - 1, own).astype(np.int32)
            face = own[face]
        return points, Part(len(points), *loops, own, triangles, face)


def _outfits(obj: bpy.types.Object, part: Part, count: int) -> list[np.ndarray]:
    """`count` times [F, 3] sRGB of a piece of clothing: with the body's outfits it changes, if it has as many."""
    own = colors.own_outfits(obj)
    own = own if len(own) == count else np.repeat(own[:1], count, axis=0)
    if own.shape[1] == len(part.loop_total) or part.own_face is not None:
        return [_filled_up(outfit, part.face_count) for outfit in own]
    # Clothing whose modifiers change its faces: its main material's colour for all of them.
    return [np.tile(np.median(outfit, axis=0), (len(part.loop_total), 1)).astype(np.float32) for outfit in own]


def _filled_up(own: np.ndarray, count: int) -> np.ndarray:
    """[count, 3]: own colours [F, 3], and their median for faces that modifiers add; fewer where the last are gone."""
    extra = np.tile(np.median(own, axis=0), (max(0, count - len(own)), 1))
    return np.concatenate([own, extra]).astype(np.float32)[:count]


def _joined(parts: list[Part], topologies: list[str]) -> dict[str, object]:
    """The mesh of several objects, one behind the other, as `Bodies` take it; the topologies of those with the logo."""
    vertices = np.cumsum([0, *(part.vertex_count for part in parts)])
    faces = np.cumsum([0, *(part.face_count for part in parts)])

    def shifted(key: str, counts: np.ndarray) -> np.ndarray:
        """Indices of all parts, behind what was counted in the parts before."""
        return np.concatenate([getattr(part, key) + n for part, n in zip(parts, counts, strict=False)])

    mesh = {"triangles": shifted("triangles", vertices), "triangle_face": shifted("triangle_face", faces)}
    if all(part.own_face is None for part in parts):
        loops = np.concatenate([part.loop_total for part in parts])
        return {**mesh, "loop_total": loops, "loop_vertices": shifted("loop_vertices", vertices)}
    # Polygons are the meshes' own and their corners the evaluated ones: no loops, but the meshes' topologies.
    record = {"meshes": topologies, "worn": sha256_arrays(*(part.loop_vertices for part in parts[1:]))}
    return {**mesh, "recorded_topology": topologies[0] if len(parts) == 1 else sha256_record(record)}


@dataclass(frozen=True)
class Export:
    """What one export wrote into `folder`."""

    folder: Path
    object: str
    logo: str
    topology: str  # of the body alone: what colours that come back are checked against
    poses: int
    faces: int
    objects: list[str]  # names of the body and of what was seen on it
    garments: list[Garment]  # what wears the logo too

    @property
    def scene(self) -> Path:
        return self.folder / "scene"

    @property
    def face_list(self) -> Path:
        return self.folder / "logo.npy"


def export(context: bpy.types.Context, obj: bpy.types.Object, logo: str, choice: PoseChoice, folder: Path) -> Export:
    """Write scene package, face list and record into `folder`, which appears whole or not at all."""
    require_body(obj)
    clothing = worn_by(obj)
    worn_elsewhere = any(logo_mask(o, logo).any() for o in clothing)
    mask = logo_mask(obj, logo) if worn_elsewhere else require_logo(obj, logo)
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another output folder")
    bodies, garments = export_bodies(context, obj, choice, logo)
    worn = [np.flatnonzero(logo_mask(bpy.data.objects[g.object], logo)) + g.first for g in garments]
    ids = np.concatenate([np.flatnonzero(mask), *worn])
    ids = np.intersect1d(ids, bodies.triangle_face)  # faces that a modifier takes away are not seen
    if not len(ids):
        raise InputError(f"No face of logo '{logo}' is left when '{obj.name}' is evaluated: look at its modifiers")
    names = [obj.name, *(o.name for o in clothing)]
    done = Export(folder, obj.name, logo, topology(obj), bodies.pose_count, bodies.face_count, names, garments)
    with new_folder(folder) as temporary:
        write_scene(temporary / "scene", bodies, creator="cloak add-on")
        write_face_list(temporary / "logo.npy", ids, bodies.topology)
        record = {key: value for key, value in asdict(done).items() if key != "folder"}
        write_json(temporary / RECORD, {"format": "cloak export", "version": 1, **record})
    return done


def read_export(folder: Path) -> Export:
    """The record of an earlier export; one that was written before there were garments has none."""
    record = read_json(folder / RECORD)
    try:
        words = {key: str(record[key]) for key in ("object", "logo", "topology")}
        counts = {key: int(record[key]) for key in ("poses", "faces")}
        garments = record.get("garments", [])
        worn = [(str(g["object"]), int(g["first"]), int(g["faces"]), str(g["topology"])) for g in garments]
        objects = [str(name) for name in record.get("objects", [])]
        return Export(folder, **words, **counts, objects=objects, garments=[Garment(*g) for g in worn])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{folder / RECORD}: not the record of an export") from None
