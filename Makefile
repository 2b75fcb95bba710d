# Two commands do all set-up: `make demo` and `make test`.
BIN := .venv/bin

.PHONY: demo test lint extension

demo: .venv/.installed
	$(BIN)/cloak demo --out runs/demo

test: .venv/.installed-test .venv-blender/.installed
	$(BIN)/python -m pytest

lint: .venv/.installed-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

extension: .venv/.installed-test .venv-blender/.installed
	.venv-blender/bin/python tools/build_extension.py

.venv/.installed: pyproject.toml tools/setup.sh
	tools/setup.sh
	touch $@

.venv/.installed-test: pyproject.toml tools/setup.sh
	tools/setup.sh test
	touch $@ .venv/.installed

# Blender as a Python package, in an environment of its own: it cannot share one with today's numpy and torch.
.venv-blender/.installed: tools/setup_blender.sh | .venv/.installed-test
	tools/setup_blender.sh
	touch $@
