"""Every text of the add-on that Blender would translate: of its classes, and of the calls that draw."""

import ast
from collections.abc import Iterator
from pathlib import Path

import bpy
import cloak
from cloak.body import panel as body_panel
from cloak.logo import paint
from cloak.result import evaluations, eye, panel
from cloak.training import detectors
from cloak.training import panel as training_panel

ROOM = Path(cloak.__file__).parent
DRAWS = {"label", "prop", "operator", "operator_menu_enum", "progress", "row", "invoke_props_dialog"}
TABLES = (
    *(("Unseen", "Random", training_panel.UNSEEN), evaluations.CONTROLS.values(), panel.CONTROL.values()),
    *(panel.RENDERS, [name for name, _ in eye.KINDS.values()]),
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


def labels() -> Iterator[str]:
    """Names that the panels put on the left of a value; those of switches stand on the right and have room."""
    kinds = (
        cloak.properties.CloakSettings,
        cloak.properties.CloakObject,
        evaluations.CloakJudging,
        detectors.CloakDetector,
    )
    known = {prop.identifier: prop for kind in kinds for prop in kind.bl_rna.properties if prop.type != "BOOLEAN"}
    for path in (path for path in ROOM.rglob("*.py") if "panel" in path.name or path.name == "wear.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "settings_column":
                yield from (known[name.value].name for name in node.args[2:] if getattr(name, "value", "") in known)
            if not isinstance(node, ast.Call) or getattr(node.func, "attr", "") != "prop":
                continue
            if getattr(node.args[1], "value", "") in known:
                words = {word.arg: word.value for word in node.keywords}
                if "text" in words:
                    yield from _texts(words["text"])
                elif "expand" not in words:
                    yield known[node.args[1].value].name


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
            elif isinstance(node, ast.keyword) and node.arg == "lacks":
                found |= {_pattern(node.value): None}
            elif isinstance(node, ast.FunctionDef) and (node.name.endswith("_reason") or node.name == "needs"):
                found |= {_pattern(said.value): None for said in ast.walk(node) if isinstance(said, ast.Return)}
    return [text for text in found if text and sum(map(str.isalpha, text)) > 5]


def _pattern(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values)
    return ""
