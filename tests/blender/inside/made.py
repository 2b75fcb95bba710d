"""Bodies to test with, made on the spot."""

from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector


def link(mesh: bpy.types.Mesh, name: str = "Body") -> bpy.types.Object:
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    return obj


def mesh_of(bm: bmesh.types.BMesh, name: str) -> bpy.types.Object:
    """An object of what was built."""
    mesh = bpy.data.meshes.new(name)
    bm.to_mesh(mesh)
    bm.free()
    return link(mesh, name)


def make_egg(rings: int = 24, height: float = 1.8, name: str = "Body") -> bpy.types.Object:
    """A closed body as tall as a person, symmetric in X: quads, with fans of triangles at both poles."""
    bm, place = bmesh.new(), Matrix.Translation((0, 0, height / 2)) @ Matrix.Diagonal((0.35, 0.25, height / 2, 1))
    bmesh.ops.create_uvsphere(bm, u_segments=2 * rings, v_segments=rings, radius=1, matrix=place)
    return mesh_of(bm, name)


def make_fine_egg(faces: int, name: str = "Fine") -> bpy.types.Object:
    """The egg with about this many faces."""
    return make_egg(round((faces / 2) ** 0.5), name=name)


def add_ngons(obj: bpy.types.Object, every: int = 7) -> None:
    """Merge pairs of neighbouring quads into hexagons, all over the body."""
    bm = bmesh.new()
    bm.from_mesh(obj.data)
    used, chosen = set(), []
    for edge in list(bm.edges)[::every]:
        if len(edge.link_faces) == 2 and all(len(f.verts) == 4 and f not in used for f in edge.link_faces):
            used.update(edge.link_faces)
            chosen.append(edge)
    bmesh.ops.dissolve_edges(bm, edges=chosen, use_verts=False)
    bm.to_mesh(obj.data)
    bm.free()
    assert any(len(polygon.vertices) > 4 for polygon in obj.data.polygons)


def make_grid(faces: int = 55_000, name: str = "Grid") -> bpy.types.Object:
    """At least `faces` triangles on a plane of 2 m that stands up and faces the front."""
    bm, side = bmesh.new(), int(np.ceil((faces / 2) ** 0.5))
    place = Matrix.Translation((0, 0, 1)) @ Matrix.Rotation(np.pi / 2, 4, "X")
    bmesh.ops.create_grid(bm, x_segments=side, y_segments=side, size=1, matrix=place)
    bmesh.ops.triangulate(bm, faces=bm.faces[:])
    return mesh_of(bm, name)


def set_mode(mode: str) -> None:
    bpy.ops.object.mode_set(mode=mode)


def select_only(obj: bpy.types.Object, ids) -> None:
    """Select faces in Edit Mode and stay there."""
    from cloak.blender import faces

    mask = np.zeros(len(obj.data.polygons), bool)
    mask[list(ids)] = True
    set_mode("EDIT")
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    faces.select_faces(obj, mask)


def made_run(
    folder: Path, obj: bpy.types.Object, ids, values: np.ndarray, topology: str = "", name: str = "run ä"
) -> Path:
    """A run folder with colours for faces of an object, as a training leaves it; without a record."""
    from cloak.blender import mesh_arrays
    from cloak.exchange.face_lists import write_colors, write_face_list

    run = folder / name
    run.mkdir(parents=True)
    write_face_list(run / "logo.npy", np.asarray(ids), topology or mesh_arrays.topology(obj))
    write_colors(run / "colors.npy", values)
    return run


def body_of_a_run(folder: Path, ids=(3, 4, 50)) -> tuple[bpy.types.Object, Path]:
    """An egg with a skin and a run that made some faces red, and the run; the body does not wear it yet."""
    obj = make_egg()
    obj.data.materials.append(bpy.data.materials.new("Skin"))
    run = made_run(folder, obj, list(ids), np.tile(np.float32([1, 0, 0]), (len(ids), 1)))
    obj.cloak.run = str(run)
    return obj, run


def logo_ids(obj: bpy.types.Object, name: str = "Logo") -> np.ndarray:
    """The faces of a logo."""
    from cloak.blender import faces

    return np.flatnonzero(faces.read_faces(obj, name))


def centers(obj: bpy.types.Object) -> np.ndarray:
    return np.array([polygon.center for polygon in obj.data.polygons], np.float32)


def add_camera(place: tuple, target: tuple = (0, 0, 0.9)) -> bpy.types.Object:
    """The scene's camera, looking at the middle of an egg."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    camera.location = place
    camera.rotation_euler = (Vector(place) - Vector(target)).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    return camera


def stroke(*dabs: tuple[tuple[float, float, float], float]) -> list[dict]:
    """A brush's dabs, places and radii, as the painting operator takes them."""
    keys = {"name": "", "mouse": (0, 0), "mouse_event": (0, 0), "pressure": 1, "x_tilt": 0, "y_tilt": 0, "time": 0}
    if "pen_flip" in bpy.types.OperatorStrokeElement.bl_rna.properties:  # Blender 4.3 asks for it
        keys["pen_flip"] = False
    return [keys | {"location": place, "size": radius, "is_start": not i} for i, (place, radius) in enumerate(dabs)]
