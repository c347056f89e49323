# SPDX-License-Identifier: Apache-2.0
# PYTHON=... names the Python to make .venv with (3.11, 3.12 or 3.13); PYTEST=... adds options to pytest,
# BLIND=... to the blind tests (python -m benchmarks.blind --help).

VENV_PYTHON := .venv/bin/python

.PHONY: help setup test demo bench blind fuzz soak docs pictures lint lock clean

help:
	@echo 'make setup   install everything into .venv; does nothing when that is done'
	@echo 'make demo    calibrate a simulated cell: ROS 2 nodes, one log, six error motions, a report'
	@echo 'make test    run the tests'
	@echo 'make bench   run the benchmarks against peers'
	@echo 'make blind   hide effects in the machine, let the diagnosis find them, print the confusion table'
	@echo 'make fuzz    10 000 made-up inputs at every door (FUZZ=... for another number)'
	@echo 'make soak    kill nodes in 30 runs, measure 100 000 balls, record 60 s at the highest rate'
	@echo 'make docs    write the pages that are made from the library'
	@echo 'make pictures  make the pictures of the docs anew (needs Chromium)'
	@echo 'make lint    check style'
	@echo 'make lock    pin the newest packages that requirements/requirements.in allows'
	@echo 'make clean   remove .venv and everything else that was made'

setup:
	@tools/setup.sh

test: setup
	@$(VENV_PYTHON) -m pytest $(PYTEST)

demo: setup
	@.venv/bin/rosette demo

bench: setup
	@$(VENV_PYTHON) -m benchmarks

blind: setup
	@$(VENV_PYTHON) -m benchmarks.blind $(BLIND)

fuzz: setup
	@FUZZ_EXAMPLES=$(or $(FUZZ),10000) $(VENV_PYTHON) -m pytest -q --timeout 7200 test/fuzz

soak: setup
	@KILLS=30 $(VENV_PYTHON) -m pytest -q --timeout 3600 test/nodes/test_cell_kills.py
	@$(VENV_PYTHON) -m benchmarks.soak
	@$(VENV_PYTHON) -m benchmarks.recorder_rate

docs: setup
	@$(VENV_PYTHON) -m rosette_ros.cli.effects_page > docs/effects.md.new
	@mv docs/effects.md.new docs/effects.md

pictures: setup
	@$(VENV_PYTHON) tools/docs_pictures.py
	@$(VENV_PYTHON) tools/studio_pictures.py

lint: setup
	@.venv/bin/ruff check

lock: setup
	@.venv/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest --python-version 3.11 \
		--generate-hashes --no-header --no-annotate \
		requirements/requirements.in --output-file requirements/requirements.lock

clean:
	rm -rf .venv build install log .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

export PYTHON
