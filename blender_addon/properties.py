# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel lets the user set: on the scene (how to export and train) and on the object (its logo, its run)."""

from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.props import CollectionProperty, PointerProperty

from .blender import blend_paths, marks
from .blender.blend_paths import absolute, blend_folder
from .blender.colors import set_look
from .blender.faces import is_logo, logo_names
from .files.errors import InputError
from .poses.poses import PoseChoice
from .session import session
from .trainer.program import options
from .training.detectors import CloakDetector, existing, trained_against
from .ui import props
from .ui.window import Hooks


def _logo_index(self: "CloakObject") -> int:
    names = self.id_data.data.attributes.keys()
    shown = [self.logo] if self.logo in names else logo_names(self.id_data.data)
    return names.index(shown[0]) if shown else -1


def _set_logo_index(self: "CloakObject", index: int) -> None:
    attributes = self.id_data.data.attributes
    if 0 <= index < len(attributes) and is_logo(attributes[index]):
        self.logo = attributes[index].name


def _remember_run(self: "CloakObject", context: bpy.types.Context) -> None:
    session.given_runs[self.id_data.session_uid] = self.run
    self.run_place = absolute(self.run)


def _look_chosen(self: "CloakSettings", context: bpy.types.Context) -> None:
    for obj in bpy.data.objects:
        if obj.type == "MESH" and obj.data.library is None:
            set_look(obj, self.look)


@persistent
def give_runs_back(*_: object) -> None:
    """After undo and redo: restore each object's run, because its training continues."""
    for obj in bpy.data.objects:
        run = session.given_runs.get(obj.session_uid)
        if run is not None and obj.library is None and obj.cloak.run != run:
            obj.cloak.run = run


class CloakObject(bpy.types.PropertyGroup):
    """What Cloak keeps on an object."""

    logo: props.text("Logo", "Name of the active logo of this object")
    logo_index: props.whole(
        "Active Logo", "Position of the active logo among the mesh's attributes", get=_logo_index, set=_set_logo_index
    )
    run: props.path(
        "Run Folder",
        "Folder of the training whose colours this object wears, or will wear",
        "DIR_PATH",
        update=_remember_run,
    )
    run_place: props.text(
        "Run's Place", "The run folder as it lies on the disk, should the file be appended to another"
    )
    worn: props.text("Worn Run", "Folder of the run whose colours are on the model")
    left_out: props.switch(
        "Leave Out",
        "The camera does not see this piece, in training, judging and films",
        update=lambda self, context: session.note_change(geometry=True),
    )
    made_from: props.text("Made From", "Of a sample body: which of Cloak's people it holds, and the hash of its faces")


class CloakJudging(bpy.types.PropertyGroup):
    """How a cloak is judged."""

    bodies: props.choice(
        "Bodies",
        "What to evaluate on",
        (
            "KEPT",
            "Kept Back",
            "Bodies that training never saw, where it ran on Cloak's own people; else the bodies of the training",
        ),
        ("FRAMES", "Frames", "This body in the frames below: choose such as training did not see"),
    )
    frame_start: props.whole("Start", "First frame to evaluate on", 1)
    frame_end: props.whole("End", "Last frame to evaluate on", 12)
    frame_step: props.whole("Step", "Frames from one to the next", 1, min=1)
    backgrounds: props.path(
        "Backgrounds",
        "Folder of photographs without people that training did not see; empty for procedural scenes that "
        "training never sees",
        "DIR_PATH",
    )
    angle: props.whole("Angle Step (°)", "Degrees from one azimuth to the next, all around the body", 15, min=1, max=90)
    images: props.whole(
        "Images",
        "Images of each kind (the cloak, and each control), spread over bodies, angles and backgrounds. "
        "More of them take longer and make the intervals narrower",
        240,
        min=8,
        max=100_000,
    )
    ring: props.switch("Ring", "Draw success by azimuth as a ring around the body's feet", True)

    eye_from: props.choice(
        "From",
        "Where the detector looks from",
        ("VIEW", "View", "Where you look from, as you move around"),
        ("CAMERA", "Camera", "The scene's camera"),
    )
    eye_background: props.whole(
        "Background",
        "Which background stands behind the body: a photograph of the training's folder by its number, or "
        "a procedural scene where there is none",
        min=0,
        max=9999,
    )

    people: props.path(
        "People", "People in photographs to wear the cloak: a people.json as COCO has them, or the folder it lies in"
    )

    film_format: props.choice(
        "Format",
        "What to write",
        ("gif", "GIF", "Plays everywhere, large"),
        ("mp4", "MP4", "Small; the trainer's Python needs the extra 'film' (PyAV)"),
        ("png", "Pictures", "A folder of PNGs"),
    )
    film_seconds: props.number("Turntable", "Seconds that a turntable takes", 6.0, min=0.5, max=120.0, subtype="TIME")

    @property
    def frames(self) -> PoseChoice | None:
        """This body's frames to evaluate on; None for the bodies that were kept back."""
        if self.bodies == "KEPT":
            return None
        return PoseChoice("RANGE", self.frame_start, self.frame_end, self.frame_step)

    @property
    def backgrounds_option(self) -> str:
        """The trainer's option for the evaluation's backgrounds."""
        return f"--backgrounds={absolute(self.backgrounds) or 'procedural:test'}"


class CloakSettings(bpy.types.PropertyGroup):
    """What Cloak keeps on a scene."""

    triangulate: props.switch(
        "Triangulate",
        "Also split every face into triangles, so that each triangle gets its own colour as in the paper",
        default=True,
    )
    tint: props.switch("Tint", "Tint the active logo's faces in the viewport", default=True)

    stamp_kind: props.choice(
        "Stamp",
        "What to project onto the body",
        ("TEXT", "Text", "A letter or a word in Blender's font"),
        ("IMAGE", "Image", "The dark, opaque pixels of an image"),
        ("SMILEY", "Smiley", "A ring with two eyes and a mouth"),
    )
    stamp_text: props.text("Text", "Text to stamp", "G")
    stamp_image: PointerProperty(
        name="Image", description="Image whose dark, opaque pixels are stamped", type=bpy.types.Image
    )
    stamp_size: props.share("Size", "Height of the stamp as a share of the body's height", 0.2, 0.01)
    stamp_center: props.share("Height", "Middle of the stamp above the ground, as a share of the body's height", 0.72)
    stamp_offset: props.share(
        "Offset", "Middle of the stamp to the right of the body's middle, as a share of the body's height", 0, -0.5, 0.5
    )
    brush_radius: props.whole(
        "Radius", "Radius of the brush that paints the logo, in pixels", 40, min=1, max=500, subtype="PIXEL"
    )
    brush_mirror: props.switch("Mirror", "Paint on the other side of the object's X = 0 plane as well")
    heat_share: props.share(
        "Share",
        "Share of the body's area that New from Heatmap takes, most sensitive faces for their size first",
        0.2,
        0.001,
    )

    pose_source: props.choice(
        "Poses",
        "Which poses to train on",
        ("CURRENT", "Current Pose", "The body as it stands now"),
        ("RANGE", "Frame Range", "Every so many frames of the animation"),
        ("ACTIONS", "All Actions", "Every so many frames of each action that moves the body"),
    )
    frame_start: props.whole("Start", "First frame to export", 1)
    frame_end: props.whole("End", "Last frame to export", 12)
    frame_step: props.whole("Step", "Frames from one exported pose to the next", 1, min=1)

    detectors: CollectionProperty(name="Detectors", description="The person detectors to hide from", type=CloakDetector)
    # What kind of detector a file of version 0.1 names; 0 for the built-in one.
    detector: props.whole("", "", options={"HIDDEN"})
    detector_index: props.whole("Detector", "The detector that is chosen in the list")
    backgrounds: props.path(
        "Backgrounds", "Folder of photographs without people; empty for procedural scenes", "DIR_PATH"
    )
    preset: props.choice(
        "Preset",
        "Which settings to train with",
        ("best", "Best", "What works best"),
        ("transfer", "Transfer", "For detectors that training never sees; takes several surrogates"),
        ("paper", "Paper", "The settings of the paper"),
        ("reference", "Reference", "The settings of the paper's published code"),
    )
    config: props.path("Settings File", "TOML file with further settings of cloak train; empty for the preset's own")
    angle_first: props.whole(
        "From", "First azimuth to train at, in degrees; 0 looks at the front", -10, min=-180, max=180
    )
    angle_last: props.whole("To", "Last azimuth to train at, in degrees", 10, min=-180, max=180)
    angle_step: props.whole("Step", "Degrees from one training azimuth to the next", 5, min=1, max=360)
    steps: props.whole("Steps", "Updates of the colours", 600, min=1, max=10_000_000)
    device: props.choice(
        "Device", "What to train on", ("cpu", "CPU", "The processor"), ("cuda", "GPU", "An NVIDIA graphics card (CUDA)")
    )
    output: props.path(
        "Output",
        "Folder that run folders are made in; empty for 'cloak runs' beside the .blend file, or for a folder "
        "beside Blender's own data while the file was never saved",
        "DIR_PATH",
    )
    look: props.choice(
        "Material",
        "What the cloak is shown with",
        ("SEEN", "As Detectors Saw", "Unlit: every colour is the trained one, whatever the light"),
        ("LOOKDEV", "Lookdev", "A matte cloth that light falls on: for pictures, not for judging"),
        update=_look_chosen,
    )
    live: props.switch("Live Colours", "Show the colours on the model while they are being trained", default=True)
    live_seconds: props.number("Every", "Seconds between live updates", 3.0, min=0.5, max=600.0)
    judging: PointerProperty(name="Judging", description="How a cloak is judged", type=CloakJudging)


def pose_choice(settings: CloakSettings) -> PoseChoice:
    """Which poses the settings ask for."""
    return PoseChoice(settings.pose_source, settings.frame_start, settings.frame_end, settings.frame_step)


def train_options(settings: CloakSettings) -> list[str]:
    """Options of `cloak train`; raises `InputError` naming the field that is missing."""
    if settings.angle_last < settings.angle_first:
        raise InputError(f"Angles {settings.angle_first} to {settings.angle_last}: the last lies before the first")
    backgrounds = absolute(settings.backgrounds)
    if backgrounds and not Path(backgrounds).is_dir():
        raise InputError(f"Backgrounds folder {backgrounds} does not exist")
    return options(
        trained_against(settings),
        backgrounds=backgrounds,
        angles=f"{settings.angle_first}:{settings.angle_last}:{settings.angle_step}",
        preset=settings.preset,
        steps=settings.steps,
        device=settings.device,
        config=existing(settings.config, "Settings File") if settings.config else "",
    )


def output_folder(settings: CloakSettings) -> Path:
    """Where runs go: the folder the user chose, `cloak runs` beside the file, or beside Blender's own data."""
    if not settings.output:
        # Beside Blender's own data what was trained outlives the add-on.
        place = blend_folder() or Path(bpy.utils.user_resource("DATAFILES", create=True))
        return place / "cloak runs"
    if settings.output.startswith("//") and not bpy.data.filepath:
        raise InputError("Output lies beside the .blend file: save that first, or choose another folder")
    return Path(absolute(settings.output))


HOOKS = Hooks(
    *blend_paths.HANDLERS,
    *(("undo_post", give_runs_back), ("redo_post", give_runs_back)),
    ("load_post", marks.mark_former),
)
CLASSES = (CloakObject, CloakJudging, CloakDetector, CloakSettings)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    _register_classes()
    bpy.types.Object.cloak = PointerProperty(type=CloakObject)
    bpy.types.Scene.cloak = PointerProperty(type=CloakSettings)
    HOOKS.register()


def unregister() -> None:
    HOOKS.unregister()
    del bpy.types.Scene.cloak
    del bpy.types.Object.cloak
    _unregister_classes()
