from cloak_core.sources.bodies.people.clothed import clothed_bodies
from tools.pretrain.clothing.tables import CLIPS


def test_the_stored_poses_are_those_of_the_tables() -> None:
    names = [f"{clip.name}-{frame:02}" for clip in CLIPS for frame in range(clip.frames)]
    assert list(clothed_bodies().names) == names
