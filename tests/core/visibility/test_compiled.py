"""Loops are compiled whether or not there is a place to keep what the compiler made."""

from numba.core import caching

from cloak_core.core.visibility import compiled
from cloak_core.core.visibility.compiled import loop


def doubled(value):
    return 2 * value


def test_a_place_for_compiled_loops_is_not_needed(monkeypatch) -> None:
    kept = loop(doubled)
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    not_kept = loop(doubled)
    assert kept(4) == not_kept(4) == 8
    assert type(kept._cache) is not type(not_kept._cache)


def test_kept_loops_are_stale_when_a_file_that_they_call_changes(tmp_path, monkeypatch) -> None:
    """numba alone would compare the caller's file and run what the callee was."""
    (tmp_path / "cpu").mkdir()
    for name in ("compiled", "screen", "cpu/callee"):
        (tmp_path / f"{name}.py").write_text("")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    compiled._source_stamp.cache_clear()
    before = loop(doubled)._cache._cache_file._source_stamp
    (tmp_path / "cpu" / "callee.py").write_text("changed")
    compiled._source_stamp.cache_clear()
    assert loop(doubled)._cache._cache_file._source_stamp != before
    compiled._source_stamp.cache_clear()
