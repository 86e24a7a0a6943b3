# `make train` and `make test` are all that a newcomer needs; both set up .venv once.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
export OMP_NUM_THREADS ?= 1
export PYTHONDONTWRITEBYTECODE :=   # else each process would compile torch anew, for ten seconds
ifndef RUN
RUN := runs/fast_$(shell date +%Y-%m-%d_%H-%M-%S)
endif

.PHONY: train demo test check test-slow lint bench docs docs-links setup clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "uavrl needs Python 3.11: install it, or name it with make PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $(READY)

# Trains until the policy flies, then evaluates it and draws some flights. ARGS="env=dynamic" changes what is trained.
# The thesis's run: .venv/bin/uavrl-train (5,000 episodes).
train: $(READY)
	@echo "Training by preset=fast in $(RUN); the thesis's 5,000 episodes: $(BIN)/uavrl-train"
	@$(BIN)/uavrl-train preset=fast run_dir=$(RUN) $(ARGS)
	@$(BIN)/uavrl-evaluate run=$(RUN) episodes=100
	@$(BIN)/uavrl-replay run=$(RUN) episodes=4 output=$(RUN)/replay.html
	@$(BIN)/python -m uavrl.cli.reached $(RUN)

demo: $(READY)
	$(BIN)/uavrl-replay policy=static tasks=[0,1,2,3] output=demo.html
	@echo "Open demo.html in a browser."

# The quick tests and the doctests. ARGS="-k lidar" chooses among them.
test: $(READY) lint
	$(BIN)/python -m pytest -n 2 --dist worksteal --ignore=tests/check $(ARGS)

# What needs processes, Ray, kills, a browser or more than some seconds.
check: $(READY)
	$(BIN)/python -m pytest -n 2 --dist worksteal tests/check $(ARGS)

# What takes more than a minute by its nature.
test-slow: $(READY)
	$(BIN)/python -m pytest -m slow $(ARGS)

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# The site, in docs/_build/html; tutorials run once and again when they change. ARGS="-D nb_execution_mode=off" shows them without.
docs: $(VENV)/.ready-docs
	$(BIN)/python -m sphinx -b html -W -n --keep-going -d docs/_build/trees $(ARGS) docs docs/_build/html
	@echo "Open docs/_build/html/index.html in a browser."

# Asks the network whether the pages that ours link to are there.
docs-links: $(VENV)/.ready-docs
	$(BIN)/python -m sphinx -b linkcheck -D nb_execution_mode=off -d docs/_build/trees docs docs/_build/links

$(VENV)/.ready-docs: $(READY)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[docs]'
	touch $@

bench: $(READY)
	for name in lidar env update buffer train; do $(BIN)/python benchmarks/$$name.py || exit 1; done

clean:
	rm -rf $(VENV)
