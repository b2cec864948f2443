# Everything runs in ./.venv, which the first target that needs it makes; only python3 (3.12 or
# newer) and make have to be there.

CONFIG ?= configs/nominal_step.yaml
ARGS ?=
SECONDS ?= 60
BIN := .venv/bin
READY := .venv/.ready
BENCH := .venv-bench/bin
BENCH_READY := .venv-bench/.ready
BROWSER := .venv-browser/bin
BROWSER_READY := .venv-browser/.ready
DOCS := .venv-docs/bin
DOCS_READY := .venv-docs/.ready
SITE := build/docs
# Contracts of the code and units that compile no new kernel.
FAST := tests/basics tests/record \
  $(addprefix tests/contracts/test_,architecture.py contracts.py formats.py mutants.py pointers.py words.py) \
  $(addprefix tests/config/,test_loading.py test_mistakes.py test_yaml_source.py records schema)

.PHONY: help posterior paper docs test test-fast test-slow check format bench bench-growth zoo modes causes real baseline mutants attack rates pages results schema dist clean

help:
	@echo "make posterior [CONFIG=configs/mine.yaml] [ARGS=--resume|--force]"
	@echo "                 the main job: a config in, results/<name>/ out"
	@echo "make paper       the studies of the paper, repeated: results/paper/ (2 to 3 minutes)"
	@echo "make results     what results/published holds, made anew from every config (5 minutes)"
	@echo "make docs        the site of docs/, its notebooks run: build/docs/index.html (2 minutes, in .venv-docs)"
	@echo "make test        the tests, about 5 minutes; the slowest twenty are listed at the end"
	@echo "make test-fast   contracts and units that compile no kernel, under a minute"
	@echo "make test-slow   longer proofs, without those of rates and attack"
	@echo "make check       format, lint, types and tests"
	@echo "make format      put the code into the project's format"
	@echo "make bench       measure bayesdrill beside its peers (about 10 minutes, in .venv-bench)"
	@echo "make bench-growth  how time and memory grow; part of make bench"
	@echo "make zoo         run records of many kinds and judge each (half an hour); ARGS=--list names them"
	@echo "make modes       run records of several modes, whose masses a grid knows (minutes); ARGS=--list names them"
	@echo "make causes      map 150 records with one lack each: is it named first? (half an hour)"
	@echo "make real        run the benches of others whose data are there (minutes); ARGS=--fetch gets them"
	@echo "make baseline    compare all results with those that are stored (4 minutes); ARGS=--write stores them"
	@echo "make mutants     break the code in named ways and see the tests fail (on two processors); ARGS=words choose"
	@echo "make attack      malformed configs, records and results, SECONDS=60 of each of 22 kinds"
	@echo "make rates       hundreds of records with a known truth: how often is the answer right? (hours)"
	@echo "make pages       look at reports in a headless Chromium, which has to be on PATH (a minute, in .venv-browser)"
	@echo "make schema      write configs/schema.json anew"
	@echo "make dist        the files of a release: dist/"
	@echo "make clean       remove .venv, .venv-bench, .venv-browser, .venv-docs, build and caches; results stay"

posterior: $(READY)
	@$(BIN)/bayesdrill posterior $(CONFIG) $(ARGS)

# What is there comes from the same configs, so it is made anew.
paper: $(READY)
	@$(BIN)/python -m studies.paper --force

results: $(READY)
	@set -e; for config in configs/*.yaml; do $(BIN)/bayesdrill posterior $$config --force; done
	@$(BIN)/bayesdrill design configs/nominal_step.yaml --high 12 --limit w_2=0: \
		--limit 'integral(r_m*i**2)=:50' --output results/nominal_step_designed --force
	@$(BIN)/python -m studies.paper --force
	@$(BIN)/python docs/results.py
	@$(BIN)/python docs/render.py

# From nothing, so that no page of another state stays; a warning or a dead link is an error.
docs: $(DOCS_READY)
	@rm -rf $(SITE) build/doctrees build/jupyter_execute
	@$(DOCS)/python -m sphinx -q -W --keep-going -j 2 -b html -d build/doctrees docs $(SITE)
	@$(DOCS)/python docs/check_site.py $(SITE)
	@echo "site: $(SITE)/index.html"

test: $(READY)
	@$(BIN)/python -m pytest -m "not slow" --ignore=benchmarks/attack -n 2 --dist loadfile --no-loadscope-reorder --durations=20

test-fast: $(READY)
	@$(BIN)/python -m pytest -q -m "not slow" $(FAST)

# Rates and attacks take hours and have targets of their own.
test-slow: $(READY)
	@$(BIN)/python -m pytest -m slow --ignore=benchmarks/rates --ignore=benchmarks/attack

check: $(READY)
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(MAKE) --no-print-directory test

format: $(READY)
	@$(BIN)/ruff check --fix-only --quiet .
	@$(BIN)/ruff format .

bench: $(BENCH_READY)
	@$(BENCH)/python -m pytest -q benchmarks/tests/test_bench.py
	@$(BENCH)/python -m benchmarks.bench

bench-growth: $(BENCH_READY)
	@$(BENCH)/python -m benchmarks.bench --only growth

zoo: $(READY)
	@$(BIN)/python -m benchmarks.zoo $(ARGS)

modes: $(READY)
	@$(BIN)/python -m benchmarks.modes $(ARGS)

causes: $(READY)
	@$(BIN)/python -m benchmarks.causes $(ARGS)

real: $(READY)
	@$(BIN)/python -m benchmarks.real $(ARGS)

baseline: $(READY)
	@$(BIN)/python -m benchmarks.baseline $(ARGS)

mutants: $(READY)
	@$(BIN)/python benchmarks/mutants.py --processes 2 $(ARGS)

attack: $(READY)
	@BAYESDRILL_ATTACK=$(SECONDS) $(BIN)/python -m pytest -m slow -q -s benchmarks/attack

rates: $(READY)
	@$(BIN)/python -m benchmarks.rates
	@$(BIN)/python -m pytest -m slow -q -s benchmarks/rates

pages: $(BROWSER_READY)
	@$(BROWSER)/python -m pytest -m slow -q tests/browser

schema: $(READY)
	@$(BIN)/bayesdrill schema > configs/schema.json

# What is not committed would be in the files too.
dist: $(READY)
	@test ! -e .git || test -z "$$(git status --porcelain)" || \
	  { echo "not committed, see git status; commit it, or put it elsewhere"; exit 1; }
	@rm -f dist/bayesdrill-*
	@$(BIN)/python -m build --no-isolation --outdir dist
	@ls -l dist

clean:
	rm -rf .venv .venv-bench .venv-browser .venv-docs build .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): requirements.lock pyproject.toml
	@python3 -c 'import sys; sys.exit(sys.version_info < (3, 12))' || \
	  { echo "python3 is older than 3.12; install a newer one and put it first on PATH"; exit 1; }
	@echo "setting up .venv (once, about a minute)"
	@python3 -m venv .venv
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -r requirements.lock
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --no-deps --editable .
	@touch $(READY)

# An environment beside .venv: its target is <folder>/.ready, its own lock the second it depends on.
define set-up
@echo "setting up $(@D) (once, about a minute)"
@python3 -m venv $(@D)
@$(@D)/bin/python -m pip install -qq --disable-pip-version-check -r requirements.lock -r $(word 2,$^)
@$(@D)/bin/python -m pip install -qq --disable-pip-version-check --no-deps --editable .
@touch $@
endef

# The peers that `make bench` measures stay out of .venv: they are no part of bayesdrill.
$(BENCH_READY): requirements.lock benchmarks/requirements.lock pyproject.toml
	$(set-up)

$(BROWSER_READY): requirements.lock tests/browser/requirements.lock pyproject.toml
	$(set-up)

# What makes the site stays out of .venv as well.
$(DOCS_READY): requirements.lock docs/requirements.lock pyproject.toml
	$(set-up)
