"""Every text of the add-on that Blender would translate: of its classes, and of the calls that draw."""

import ast
from collections.abc import Iterator
from pathlib import Path

import bpy
import cloak
from cloak.body import panel as body_panel
from cloak.logo import paint
from cloak.result import evaluations, panel
from cloak.training import panel as training_panel

ROOM = Path(cloak.__file__).parent
DRAWS = {"label", "prop", "operator", "operator_menu_enum", "progress", "row", "invoke_props_dialog"}
TABLES = (
    *(("Unseen", "Random", training_panel.UNSEEN), evaluations.CONTROLS.values(), panel.CONTROL.values()),
    *(panel.RENDERS.values(), [name for name, _ in evaluations.KINDS.values()]),
)
"""What panels go through."""
BLENDERS = {"filepath", "check_existing"}
"""Properties that Blender's own base classes bring, with its own translations."""
MODES = ("require_object_mode", "mode_reason")
"""Functions that are told a sentence with a {mode}."""
WORDS = {"text", "heading", "confirm_text"}


def msgids() -> list[str]:
    """In order of first appearance; texts without letters aside."""
    found = dict.fromkeys([*of_classes(), *of_drawing()])
    return [text for text in found if sum(map(str.isalpha, text)) > 1]


def of_classes() -> Iterator[str]:
    for cls in (*cloak.CLASSES, *cloak.properties.CLASSES, *cloak.training.run_list.CLASSES):
        rna = cls.bl_rna
        if issubclass(cls, bpy.types.Operator):
            rna = getattr(bpy.ops.cloak, cls.bl_idname.removeprefix("cloak.")).get_rna_type()
            yield from (rna.name, rna.description)
        elif issubclass(cls, bpy.types.Panel):
            yield cls.bl_label
        own = {key for kind in cls.__mro__ for key in getattr(kind, "__annotations__", {})}
        for prop in rna.properties:
            if prop.identifier in own - BLENDERS and not prop.is_hidden:
                yield from (prop.name, prop.description)
                for item in getattr(prop, "enum_items", ()) if prop.type == "ENUM" else ():
                    yield from (item.name, item.description)
    yield from (paint.PaintTool.bl_label, paint.PaintTool.bl_description)


def of_drawing() -> Iterator[str]:
    for path in sorted(ROOM.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in DRAWS:
                for word in node.keywords:
                    if word.arg in WORDS:
                        yield from _texts(word.value)


def _texts(node: ast.AST) -> Iterator[str]:
    """The whole texts of an expression, such as both ends of a condition; not the pieces of an f-string."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from (*_texts(node.body), *_texts(node.orelse))
    elif isinstance(node, ast.BoolOp):
        for value in node.values:
            yield from _texts(value)


def sentences() -> list[str]:
    """What `InputError` is told and what panels say, with {} for whatever it is about."""
    found = dict.fromkeys(word for table in TABLES for word in table) | {body_panel.UNSEEN: None}
    for path in sorted(ROOM.rglob("*.py")):
        rooms = path.relative_to(ROOM).parts
        if rooms[0] in ("files", "exchange") or path.name == "headless.py":
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("InputError", "said"):
                found |= {_pattern(node.args[0]): None}
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in MODES:
                found |= {_pattern(node.args[1]).replace("{mode}", "{}"): None}
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("wrapped", "figure"):
                found |= {_pattern(word): None for word in node.args[1:3]}
            elif isinstance(node, ast.Lambda):  # a reason of one operator alone
                found |= dict.fromkeys(_texts(node.body))
            elif isinstance(node, ast.FunctionDef) and (node.name.endswith("_reason")):
                found |= {_pattern(said.value): None for said in ast.walk(node) if isinstance(said, ast.Return)}
    return [text for text in found if text and sum(map(str.isalpha, text)) > 5]


def _pattern(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values)
    return ""
