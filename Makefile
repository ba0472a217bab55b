# make demo   fly the mock, diagnose its hidden effect, write the report
# make test   the tests of every change
# make test-all  those that take long as well: every page's commands, every case of the verdict, every journey
# make lint   ruff, mypy, import-linter, the glossary's rules for identifiers and docstrings
# make kernels  the machine code that many tests need, into the cache; make test compiles what it lacks
# make docs   the documentation as a site in build/site; a warning is an error
# make study  the slow measurements in benchmarks/, each of which writes its own page; a failure is listed at the end.
#             make benchmarks/THEME.py takes those of one theme, make benchmarks/THEME/NAME.py one alone
#             (.venv/bin/python -m benchmarks lists them, --help has a measurement's options, --quick its smallest form)
# make verdict  the judge of diagnosis: cases with a known truth, a line of scores a set, under an hour on two cores
#             (ALULA_RECORDINGS=FOLDER with flights of PX4 and RotorPy); part of study
# make study-public DIR=FOLDER  scores the public data sets that a user has downloaded into a folder (SETS="nanobench idsia")
# make study-faults  planned faults in flight (fixtures/fault_cases) by 5 seeds and 4 models; part of study, resumes
# make hour   from PX4's logs of a drone to a flown, identified model, with the time of each step
# make wheel  wheels for the flight computer, with compiled controllers of the bundled vehicles: dist/
# make conformance  the mock against PX4's measured behaviour from outside, the long flights among it; part of study
# make fuzz   mutated inputs of every reader and calls of the kernels, for hours, with rising seeds; finds go to build/fuzz
# make licences  the locks and the licence page anew, after a change of pyproject.toml or constraints.txt; needs uv
# Everything is installed into .venv at the versions of constraints.txt, for demo, test and lint file by file with the
# hashes of requirements/, torch aside; nothing but Python 3.11+, a C compiler and make is needed beforehand.

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
LOCKED := $(PIP) --require-hashes --no-deps --requirement
# one thread a library: with their pools two workers on two processors took 115 s for a test of 23 s; byte code is kept
# though the environment says not to: without it each of hundreds of processes compiles 300 of our modules, for 1 s
PYTEST := env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses logical --dist loadfile --no-loadscope-reorder --durations 30
RECIPE := pyproject.toml constraints.txt $(wildcard requirements/*.lock)
HOURS ?= 8
UV ?= uv
# scripts with a command of their own; all other measurements are in benchmarks/catalogue.py
STUDIES := $(filter-out benchmarks/__main__.py,$(shell grep -l '^if __name__ == "__main__"' benchmarks/*.py))
MACHINES ?= x86_64 aarch64

.PHONY: demo hour test test-all kernels lint docs study verdict study-public study-faults wheel fuzz licences conformance clean $(STUDIES)
.NOTPARALLEL:

demo: .venv/workbench.stamp
	$(BIN)/alula demo

hour: .venv/workbench.stamp
	$(BIN)/python examples/whole_hour.py --out "$$(mktemp -d)/whole_hour"

test: .venv/development.stamp
	$(PYTEST)

test-all: .venv/development.stamp
	$(PYTEST) -m "slow or not slow"

kernels: .venv/development.stamp
	$(BIN)/python -m fixtures.kernels

lint: .venv/development.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/identifiers.py
	$(BIN)/python .ci/result_ages.py

docs: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@! grep -rnoE '(src="https?:|<link[^>]*href="https?:)[^"]*"' build/site --include='*.html' # it loads nothing from a network

study: benchmarks/all.py $(STUDIES) verdict conformance

verdict: .venv/workbench.stamp
	$(BIN)/python -m benchmarks.verdict

study-public: .venv/workbench.stamp
	@test -n "$(DIR)" || (echo "study-public: give the folder of your downloads: make study-public DIR=~/datasets" >&2; exit 2)
	$(BIN)/python -m benchmarks public_sets score "$(DIR)" $(if $(SETS),--sets $(SETS))

conformance: .venv/development.stamp
	$(BIN)/python -m pytest -m "slow or not slow" tests/conformance

study-faults: .venv/workbench.stamp
	$(BIN)/python -m benchmarks faults study --jobs 2

wheel: .venv/workbench.stamp
	bash .ci/wheels dist $(MACHINES)
	$(BIN)/python requirements/sbom.py dist

fuzz: .venv/development.stamp
	$(BIN)/python -m tests.fuzz --hours $(HOURS)

licences: .venv/development.stamp
	$(BIN)/python requirements/make_locks.py --uv $(UV)
	$(BIN)/python docs/make_licences.py

$(STUDIES): .venv/workbench.stamp
	$(BIN)/python -m $(subst /,.,$(basename $@))

benchmarks/%.py: .venv/workbench.stamp FORCE
	$(BIN)/python -m benchmarks $(subst /, ,$*)

FORCE:

.venv/python.stamp:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Alula needs Python 3.11 or newer: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	touch $@

.venv/workbench.stamp: .venv/python.stamp $(RECIPE)
	$(LOCKED) requirements/workbench.lock
	$(PIP) --constraint constraints.txt torch==2.13.0
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

.venv/development.stamp: .venv/workbench.stamp
	$(LOCKED) requirements/development.lock
	touch $@

.venv/docs.stamp: .venv/python.stamp $(RECIPE)
	$(PIP) --constraint constraints.txt --editable '.[docs]'
	touch $@

clean:
	rm -rf .venv
