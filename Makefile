# Two commands on a machine with Python >= 3.11 and make: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo

# Small matrices gain nothing from threads, and threads that wait by spinning starve those that work.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_WAIT_POLICY ?= PASSIVE
# pip compiles nothing here: every process would, if none were to keep what it compiled.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test check pytest bench dist wheel clean

demo: $(VENV)/.demo
	$(BIN)/kinecast demo --out $(OUT)
	$(BIN)/kinecast simulate --out $(OUT)/robot

test: check pytest

pytest: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

check: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

dist: build/venv
	rm -rf dist
	PIP_CONSTRAINT=constraints.txt $</bin/python -m build

wheel: dist
	$(PYTHON) .ci/check_wheel.py dist/*.whl

bench: $(VENV)/.bench
	$(BIN)/python -m benchmarks.online_step
	$(BIN)/python -m benchmarks.inverse_kinematics

$(VENV)/bin/python:
	$(PYTHON) -c "import sys; sys.exit('kinecast needs Python 3.11 or newer') if sys.version_info < (3, 11) else None"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[train,robot]'
	touch $@

$(VENV)/.test: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

build/venv: constraints.txt
	$(PYTHON) -m venv $@
	$@/bin/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt build
	touch $@

$(VENV)/.bench: $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

clean:
	rm -rf $(VENV) out build dist
