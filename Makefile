# Each command installs what it needs into .venv. It needs Python >= 3.11, pip and make.
#   make plot           draw a controller on a hard arm into trace.png
#   make leaderboard    run the short form of the leaderboard, of all three classes of robots, and print it
#   make test           check everything but what is slow by nature; slow pages where pages or public names changed
#   make test-long      run the tests that are slow by nature, before a board or a release
#   make docs           build the documentation into build/docs

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable

.PHONY: plot leaderboard test test-long lint compile format docs constraints test-oldest clean

plot: .venv/ready-bench
	$(BIN)/fbl-gym evaluate cascade-flm@tuned --scenario everything-2 --plot trace.png

leaderboard: .venv/ready-bench
	$(BIN)/fbl-gym leaderboard --short

# The slow tests of pages run too where a page or a public name changed since main, or if git does not know main or
# the commit before.
BASE = $(shell git merge-base HEAD~ origin/main 2>/dev/null || echo HEAD~)
PAGES := '*.md' docs tests/test_docs.py Makefile
CODE := fbl_gym controllers benchmarks
PUBLIC := ^-( *(def|class) [a-zA-Z]|[a-zA-Z]|    [a-z_]+:|.*add_argument)

test: .venv/ready-dev
	$(MAKE) --no-print-directory -j2 lint compile
	$(BIN)/python -m pytest -n 2 --dist loadfile
	if ! git diff --quiet $(BASE) -- $(PAGES) || git diff --no-renames $(BASE) -- $(CODE) | grep -qE '$(PUBLIC)'; then \
		$(BIN)/python -m pytest -n 2 -m 'slow and page'; fi

test-long: .venv/ready-dev
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

lint: .venv/ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/zizmor --offline --quiet .github

# Compiles what most tests need, once and not in each of their processes.
compile: .venv/ready-dev
	$(BIN)/fbl-gym doctor --compile > /dev/null

docs: .venv/ready-dev
	$(BIN)/sphinx-build -q -E -W --keep-going -b html docs build/docs
	@echo "open build/docs/index.html"

format: .venv/ready-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/python:
	$(PYTHON) -c 'import sys; sys.exit("fbl-gym needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv .venv
	touch $@

.venv/ready-bench: .venv/python pyproject.toml constraints.txt
	$(INSTALL) '.[analysis,mpc]'
	touch $@

.venv/ready-dev: .venv/python pyproject.toml constraints.txt
	$(INSTALL) '.[all,dev]'
	touch $@

# Writes the versions that the commands above install, for Python 3.11 and newer, without those for a GPU.
constraints:
	printf 'torch==2.13.0\n' > .venv/pins.txt
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --no-header --no-annotate --constraint .venv/pins.txt \
		--extra all --extra dev pyproject.toml | grep -vE '^(nvidia|cuda|triton)' > .venv/constraints.txt
	mv .venv/constraints.txt constraints.txt

# Tests every lower bound of pyproject.toml, of all extras but `cuda`, in .venv-oldest; torch is that of constraints.txt.
test-oldest:
	$(PYTHON) -m venv .venv-oldest
	.venv-oldest/bin/python -m pip install --quiet uv
	grep '^torch==' constraints.txt > .venv-oldest/pins.txt
	.venv-oldest/bin/uv pip compile --quiet --resolution lowest-direct --no-header --no-annotate --constraint .venv-oldest/pins.txt \
		--extra all --extra dev pyproject.toml | grep -vE '^(nvidia|cuda|triton)' > .venv-oldest/oldest.txt
	.venv-oldest/bin/python -m pip install --quiet --requirement .venv-oldest/oldest.txt --editable .
	.venv-oldest/bin/python -m pytest -n 2 --dist loadfile -m '' -W default

clean:
	rm -rf .venv .venv-oldest build dist results .*_cache .hypothesis
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
