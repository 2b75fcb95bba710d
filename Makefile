# Two commands do all set-up: `make demo` and `make test`.
BIN := .venv/bin
# This checkout's code, also where another one shares the environment.
export PYTHONPATH := $(CURDIR)$(if $(PYTHONPATH),:$(PYTHONPATH))
# A process for every core (up to eight: each takes a gigabyte), each with one thread. Compiled modules are kept, also
# where the environment says not to: compiling them anew takes each process 12 seconds.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --maxprocesses 8 --dist worksteal

.PHONY: demo check gpu test test-all lint extension repository dist docs

demo: .venv/.installed
	$(BIN)/python -m cloak_core demo --out runs/demo

# The inner loop: tests whose cases take less than about a second together.
check: .venv/.installed-test
	$(PYTEST) -m "not slow and not long" --ignore tests/blender

test: .venv/.installed-test .venv-blender/.installed
	$(PYTEST) -m "not long"

# Everything, also what is slow by nature; .ci/run runs it.
test-all: .venv/.installed-test .venv-blender/.installed
	$(PYTEST)

# What only a CUDA device can tell; without one, which parts were not run.
gpu: .venv/.installed
	$(BIN)/python -m cloak_core bench gpu --out runs/gpu.json

lint: .venv/.installed-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

extension: .venv/.installed .venv-blender/.installed
	.venv-blender/bin/python tools/build_extension.py

# Our own extension repository: dist/repository, for any web server; with CLOAK_URL its manifest names the site.
repository: .venv/.installed .venv-blender/.installed
	.venv-blender/bin/python tools/build_extension.py --out dist/repository --repository

# What is uploaded: the wheel and the sources, checked. CLOAK_URL=https://... is where the README's links lead then.
dist: .venv/.installed-test
	$(BIN)/python -m build --outdir dist
	$(BIN)/twine check --strict dist/*.whl dist/*.tar.gz

# The site, in site/: opens from the disk.
docs: .venv/.installed-docs
	$(BIN)/python tools/build_docs.py

.venv/.installed: pyproject.toml tools/setup.sh
	tools/setup.sh
	touch $@

.venv/.installed-test: pyproject.toml tools/setup.sh
	tools/setup.sh test
	touch $@ .venv/.installed .venv/.installed-docs

.venv/.installed-docs: pyproject.toml tools/setup.sh
	tools/setup.sh docs
	touch $@ .venv/.installed

# Blender as a Python package, in an environment of its own: it cannot share one with today's numpy and torch.
.venv-blender/.installed: tools/setup_blender.sh | .venv/.installed-test
	tools/setup_blender.sh
	touch $@
