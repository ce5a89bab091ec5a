# Two commands, each enough on a fresh machine with Python >= 3.10, pip and make:
#   make leaderboard    run the leaderboard and print it
#   make test           check everything
# And: make docs        build the documentation into build/docs

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable

.PHONY: leaderboard test lint format docs constraints test-oldest clean

leaderboard: .venv/ready-bench
	$(BIN)/fbl-gym leaderboard

test: .venv/ready-dev lint
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: .venv/ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

docs: .venv/ready-dev
	$(BIN)/sphinx-build -q -E -W --keep-going -b html docs build/docs
	@echo "open build/docs/index.html"

format: .venv/ready-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/python:
	$(PYTHON) -c 'import sys; sys.exit("fbl-gym needs Python 3.10 or newer, this is " + sys.version) if sys.version_info < (3, 10) else 0'
	$(PYTHON) -m venv .venv
	touch $@

.venv/ready-bench: .venv/python pyproject.toml constraints.txt
	$(INSTALL) '.[bench,mpc]'
	touch $@

.venv/ready-dev: .venv/python pyproject.toml constraints.txt
	$(INSTALL) '.[all,dev]'
	touch $@

# The versions that the commands above install, for Python 3.10 and newer. What torch brings along is left to torch.
constraints:
	printf 'torch==2.13.0\n' > .venv/pins.txt
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.10 --no-header --no-annotate --constraint .venv/pins.txt \
		--all-extras pyproject.toml | grep -vE '^(nvidia|cuda|triton)' > .venv/constraints.txt
	mv .venv/constraints.txt constraints.txt

# The lower bounds of pyproject.toml, in an environment of its own.
test-oldest:
	$(PYTHON) -m venv .venv-oldest
	.venv-oldest/bin/python -m pip install --quiet 'gymnasium==1.2.0' 'numpy==2.0.0' 'scipy==1.14.0' 'numba==0.61.0' \
		'filterpy==1.4.5' 'matplotlib==3.9.0' 'rich==13.7.0' 'stable-baselines3==2.7.0' 'torch>=2.6,<2.14' \
		hypothesis mujoco pin pytest pytest-xdist hatchling
	.venv-oldest/bin/python -m pip install --quiet --no-deps --editable .
	.venv-oldest/bin/python -m pytest -n 2 --dist loadfile -W default

clean:
	rm -rf .venv .venv-oldest build dist results .*_cache .hypothesis
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
