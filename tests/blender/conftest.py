"""The tests in inside/ run under a Python that has bpy, in processes of their own: see test_in_blender.py."""

collect_ignore = ["inside"]
