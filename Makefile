# `make train` and `make test` are all that a newcomer needs; both set up .venv once.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEV := $(VENV)/.ready-dev
DOCS := $(VENV)/.ready-docs
# The newest fitting Python here, unless make PYTHON=/path/to/python3 names one.
fits = -c 'import sys, ensurepip, venv; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null
PYTHON ?= $(shell for name in python3.13 python3.12 python3.11 python3; do $$name $(fits) && echo $$name && break; done)
install = $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e ./onboard -e
export OMP_NUM_THREADS ?= 1
export PYTHONDONTWRITEBYTECODE :=   # else each process would compile torch anew, for ten seconds
ifndef RUN
RUN := runs/dagger_$(shell date +%Y-%m-%d_%H-%M-%S)
endif

.PHONY: train demo test check test-slow check-python lint bench docs docs-links setup clean

setup: $(READY)

$(BIN)/python:
	@test -n "$(PYTHON)" && $(PYTHON) $(fits) || { echo "uavrl needs Python 3.11, 3.12 or 3.13 with its venv module (Debian and Ubuntu: apt install python3-venv): install one, or name it with make PYTHON=/path/to/python3"; exit 1; }
	$(PYTHON) -m venv $(VENV)

# What trains, evaluates and draws.
$(READY): pyproject.toml onboard/pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing PyTorch and the rest into $(VENV): 6 GB, some minutes. Without CUDA it is 1.4 GB: see README.md."
	$(install) '.[report,train]'
	touch $@

# What tests and develops, on top.
$(DEV): $(READY)
	$(install) '.[dev]'
	touch $@

# Trains a policy, then evaluates it in ten valleys that it never saw (the suite's held_out), with all processors, and at the
# same time draws some episodes in one of them. ARGS="env=dynamic" changes what is trained, and the environment of the evaluation with it.
# The thesis's run: .venv/bin/uavrl-train (5,000 episodes).
train: $(READY)
	@echo "Training by preset=dagger in $(RUN), then 100 tasks in valleys that it never saw; the thesis's 5,000 episodes: $(BIN)/uavrl-train"
	@$(BIN)/uavrl-train preset=dagger run_dir=$(RUN) $(ARGS)
	@trap 'kill $$! 2>/dev/null' INT EXIT; \
	$(BIN)/uavrl-replay run=$(RUN) 'valleys=[100]' episodes=4 output=$(RUN)/replay.html > $(RUN)/replay.txt 2>&1 & \
	$(BIN)/uavrl-evaluate run=$(RUN) episodes=100 processes=null || exit; \
	wait $$! || { cat $(RUN)/replay.txt; exit 1; }
	@$(BIN)/python -m uavrl.cli.run_summary $(RUN)

# Four episodes of the packaged policy in a valley that it never saw.
demo: $(READY)
	$(BIN)/uavrl-replay policy=best valleys=[100] tasks=[0,1,2,3] output=demo.html
	@echo "Open demo.html in a browser."

# The quick tests and the doctests. ARGS="-k lidar" chooses among them.
test: $(DEV) lint
	$(BIN)/python -m pytest -n 2 --dist worksteal --ignore=tests/check $(ARGS)

# What needs processes, Ray, kills, a browser, the built site or more than some seconds.
check: $(DEV) $(DOCS)
	$(BIN)/python -m pytest -n 2 --dist worksteal tests/check examples/walker/tests studies/tests $(ARGS)

# What takes more than a minute by its nature.
test-slow: $(DEV)
	$(BIN)/python -m pytest -m slow -o faulthandler_timeout=0 $(ARGS)

# `make test` under Debian 13's Python, in a root of its own. Takes root on a Debian or Ubuntu, and debootstrap.
check-python:
	.ci/check_python $(or $(TARGETS),test)

lint: $(DEV)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# The site, in docs/_build/html; tutorials run once and again when they change. ARGS="-D nb_execution_mode=off" shows them without.
# Then its pages are read for broken links and for what a screen reader misses.
docs: $(DOCS)
	$(BIN)/python -m sphinx -b html -W -n --keep-going -d docs/_build/trees $(ARGS) docs docs/_build/html
	$(BIN)/python -m tools.check_site docs/_build/html
	@echo "Open docs/_build/html/index.html in a browser."

# Asks the network whether the pages that ours link to are there.
docs-links: $(DOCS)
	$(BIN)/python -m sphinx -b linkcheck -D nb_execution_mode=off -d docs/_build/trees docs docs/_build/links

$(DOCS): $(READY)
	$(install) '.[docs]'
	touch $@

bench: $(DEV)
	for name in lidar env update buffer train; do $(BIN)/python benchmarks/$$name.py || exit 1; done

clean:
	rm -rf $(VENV)
