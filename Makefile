# SPDX-License-Identifier: Apache-2.0
# PYTHON=... names the Python to make .venv with (3.11, 3.12 or 3.13); PYTEST=... adds options to pytest,
# BLIND=... to the blind tests (python -m benchmarks.blind --help).

VENV_PYTHON := .venv/bin/python
# Tests run in WORKERS processes: cells mostly wait, so more than two for each core of a small computer, which four leave
# idle for 14 % of the time and five for 4 %; a sixth costs what it gains, as each loads all tests. The tests of a file
# stay together, as they share a cell or a studio; those that take long or wait start first (test/conftest.py).
WORKERS := 5
SIDE_BY_SIDE := -n $(WORKERS) --dist loadfile --no-loadscope-reorder --durations 25

.PHONY: help setup test test-all demo bench blind fuzz soak docs docs-site notebooks pictures lint lock clean

help:
	@echo 'make setup   install everything into .venv; does nothing when that is done'
	@echo 'make demo    calibrate a simulated cell: ROS 2 nodes, one log, six error motions, a report'
	@echo 'make test    run the tests of physics, formats, errors, one cell, one story in the browser'
	@echo 'make test-all  run the long ones too: kills, hangs, several cells, papers, seeds'
	@echo 'make bench   run the benchmarks against peers'
	@echo 'make blind   blind tests: the machine hides effects, the diagnosis has to identify them'
	@echo 'make fuzz    10 000 generated inputs at every interface (FUZZ=... for another number)'
	@echo 'make soak    kill nodes in 60 runs, measure 100 000 balls, record 2 x 2000 messages/s for 60 s'
	@echo 'make docs    write what is made from the code: docs/effects.md, message types of tables'
	@echo 'make docs-site build the documentation as a site in build/site'
	@echo 'make notebooks run the notebooks of examples/ and store what they show'
	@echo 'make pictures  make the pictures of the documentation again (needs Chromium)'
	@echo 'make lint    check style and types'
	@echo 'make lock    pin the newest packages that requirements/requirements.in allows'
	@echo 'make clean   remove .venv and everything else that was made'

setup:
	@tools/setup.sh

test: setup
	@$(VENV_PYTHON) -m pytest $(SIDE_BY_SIDE) -m 'not long' $(PYTEST)

test-all: setup
	@$(VENV_PYTHON) -m pytest $(SIDE_BY_SIDE) $(PYTEST)

demo: setup
	@.venv/bin/rosette demo

bench: setup
	@$(VENV_PYTHON) -m benchmarks

blind: setup
	@$(VENV_PYTHON) -m benchmarks.blind $(BLIND)

fuzz: setup
	@FUZZ_EXAMPLES=$(or $(FUZZ),10000) $(VENV_PYTHON) -m pytest -q --timeout 7200 test/fuzz test/certificate/test_dcc_check.py

soak: setup
	@KILLS=60 $(VENV_PYTHON) -m pytest -q --timeout 3600 test/nodes/test_cell_kills.py
	@KILLS=30 $(VENV_PYTHON) -m pytest -q --timeout 3600 test/nodes/test_cell_until.py -k killed
	@$(VENV_PYTHON) -m benchmarks.soak
	@$(VENV_PYTHON) -m benchmarks.recorder_rate

docs: setup
	@$(VENV_PYTHON) tools/effects_page.py > docs/effects.md.new
	@mv docs/effects.md.new docs/effects.md
	@$(VENV_PYTHON) tools/stored_types.py > rosette_ros/io/definitions.json.new
	@mv rosette_ros/io/definitions.json.new rosette_ros/io/definitions.json

docs-site: setup
	@.venv/bin/uv venv --quiet --clear --python $(VENV_PYTHON) build/docs-env
	@.venv/bin/uv pip install --quiet --python build/docs-env/bin/python '.[docs]'
	@build/docs-env/bin/python tools/docs_site.py

notebooks: setup
	@$(VENV_PYTHON) tools/notebooks.py

pictures: setup
	@$(VENV_PYTHON) tools/docs_pictures.py
	@$(VENV_PYTHON) tools/studio_pictures.py

lint: setup
	@.venv/bin/ruff check
	@.venv/bin/mypy

lock: setup
	@.venv/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
		--generate-hashes --no-header --no-annotate \
		requirements/requirements.in setup.py --extra all --output-file requirements/requirements.lock

clean:
	rm -rf .venv build install log .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

export PYTHON
# Tests start Python some hundred times: also where Python shall write no byte code, it does so here.
test test-all: export PYTHONDONTWRITEBYTECODE :=
# Sums are rounded alike on all x86-64 processors that have this kernel, those with AVX2 and AVX-512.
test test-all: export OPENBLAS_CORETYPE := $(shell grep -qsm1 avx2 /proc/cpuinfo && echo Haswell)
# Memory in pages of 2 MB, which is kept: tests that compute take 12 to 17 % less time on a virtual computer.
test test-all: export GLIBC_TUNABLES := glibc.malloc.hugetlb=1:glibc.malloc.mmap_threshold=33554432:glibc.malloc.trim_threshold=268435456
test test-all: export PYTHONMALLOC := malloc
