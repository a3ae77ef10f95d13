# Each of `make test` and `make reproduce-table` is all that a fresh clone needs: they make .venv and install into it.
# With PYTHON=python3.13, say, the environment is another one, .venv-3.13.

PYTHON ?= python3
ifeq ($(origin PYTHON),file)
VENV := .venv
else
VENV := .venv-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
endif
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
RUNS ?= traces
THREADS ?= 2
IN_PARALLEL := -n $(THREADS) --dist worksteal
# What runs in minutes without compiled kernels: all commands on small inputs, and each kind of kernel against its model.
NOJIT := tests/nptrace/test_without_jit.py tests/rtrace/test_visit_rules.py::test_what_is_no_ray_hits_nothing_and_visits_the_root_at_most \
	tests/rtrace/test_traverse.py::test_interval_ends_belong_to_the_interval tests/rtrace/test_traverse.py::test_visits_and_hits_on_a_lattice \
	tests/rtrace/trees/test_bvh.py::test_binned_equals_brute_force tests/rtrace/trees/test_bvh.py::test_sweep_equals_brute_force \
	tests/cachesim/test_replay.py::test_every_count_is_that_of_the_model \
	tests/cachesim/test_sweep.py::test_cells_are_those_of_the_model tests/cachesim/test_opt.py::test_every_count_is_that_of_the_model
PAGES := README.md docs/does-it-pay.md docs/table1.md docs/correctness.md docs/performance.md docs/speed-error.md \
	docs/your-scene.md docs/metrics.md docs/model.md docs/commands.md docs/extending.md docs/scale.md docs/study.md

.DEFAULT_GOAL := help
.PHONY: help test test-nojit bench lint wheel-check map study pay-data pictures docs docs-check site correctness fuzz speed-error reproduce-table clean

help: ## Say what each target does
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-18s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(INSTALLED): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

test: $(INSTALLED) ## Run the tests, a quarter of an hour on two cores (with the real scenes too when NPTRACE_SCENES names their folder; PYTHON=python3.13: on that)
	@$(if $(PYTEST_ARGS),:,echo "all tests: about a quarter of an hour on two cores; some minutes more the first time, to compile kernels")
	$(BIN)/python -m pytest $(IN_PARALLEL) $(PYTEST_ARGS)

test-nojit: $(INSTALLED) ## Run the tests of the kernels as plain Python (NUMBA_DISABLE_JIT=1), two minutes
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest $(IN_PARALLEL) -q -p no:cacheprovider $(NOJIT) $(PYTEST_ARGS)

lint: $(INSTALLED) ## Check style, types and the import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

wheel-check: $(INSTALLED) ## Install the built wheel into a fresh environment and use it outside the checkout
	$(BIN)/python -m tests.wheel_check

reproduce-table: $(INSTALLED) ## Render the four scenes with both trees and print Table I beside the paper's
	@$(BIN)/nptrace render bunny conference sibenik sponza --out $(RUNS) --threads $(THREADS)
	@$(BIN)/npcache table1 --traces $(RUNS)
	@echo "A picture of every scene: $(RUNS)/*/image.png"

map: $(INSTALLED) ## Map where prefetching pays, on the four scenes, twenty minutes, and write docs/does-it-pay.md (ARGS=--quick: a minute, writes nothing)
	@test -n "$(ARGS)" || test -f "$(NPTRACE_SCENES)/bunny.ply" || { echo "set NPTRACE_SCENES to the folder with the real scenes"; exit 2; }
	$(BIN)/nptrace map bunny conference sibenik sponza --out $(VENV)/map $(or $(ARGS),-o $(VENV)/map.parquet --plot docs/map.png)
	@test -n "$(ARGS)" || { $(BIN)/python docs/pay.py $(VENV)/map.parquet && $(BIN)/cog -r docs/does-it-pay.md; }

study: $(INSTALLED) ## Measure every knob that Table I leaves open, twenty minutes on two cores, and write docs/study.md (ARGS=--quick: half a minute, writes nothing)
	@test -n "$(ARGS)" || test -f "$(NPTRACE_SCENES)/bunny.ply" || { echo "set NPTRACE_SCENES to the folder with the real scenes"; exit 2; }
	$(BIN)/python -m nptrace.table1_study --threads $(THREADS) --out $(VENV)/study -o $(or $(and $(ARGS),$(VENV)/quick.parquet),docs/data/study.parquet) $(ARGS)
	@test -n "$(ARGS)" || { $(BIN)/python docs/study_figures.py docs/data/study.parquet && $(BIN)/cog -r docs/study.md; }

docs: $(INSTALLED) ## Write the figures of README.md and docs/ again (NPTRACE_SCENES must name the real scenes)
	@test -f "$(NPTRACE_SCENES)/bunny.ply" || { echo "set NPTRACE_SCENES to the folder with the real scenes"; exit 2; }
	$(BIN)/nptrace render bunny conference sibenik sponza --out $(VENV)/runs --overwrite
	$(BIN)/npcache table1 --traces $(VENV)/runs --format csv -o docs/data/table1.csv
	$(MAKE) pay-data
	$(BIN)/nptrace render blob room nave court --accel bvh --pixels 320x320 --out $(VENV)/stand-ins --overwrite
	$(BIN)/python docs/pictures.py docs/scenes.png $(VENV)/stand-ins/*/image.png
	$(MAKE) pictures
	$(BIN)/nptrace check bunny conference sibenik sponza --json > docs/data/embree.json
	$(BIN)/cog -r $(PAGES)

COURT := $(VENV)/pictures/court-standin
pictures: $(INSTALLED) # the heat map and the curve of the README, of a built-in scene
	$(BIN)/nptrace render court --out $(VENV)/pictures
	$(BIN)/nptrace view $(COURT)-kdtree $(COURT)-bvh --heat accesses -o docs/heat.png
	$(BIN)/npcache sweep $(COURT)-bvh --size 1K..256K --ways 1,2,4,8 --prefetch none --plot docs/curve.png -o $(VENV)/curve.csv

RAYS := --rays 1,4,16,64 --mshrs 64 --prefetch stack,push,ttp,next-line:tagged,next-line:miss,treelet,perfect --format csv
PAY := run,scene,tree,group,line_bytes,layout,prefetch,cycles_per_ray,speed_up,share_of_bound,traffic_ratio,accuracy,coverage
pay-data: $(INSTALLED) # the figures of docs/does-it-pay.md except the map's, from the runs that `docs` renders
	$(BIN)/nptrace render bunny conference sibenik sponza --accel bvh --bvh-nodes 64 --out $(VENV)/runs --overwrite
	$(BIN)/npcache compare $(VENV)/runs/*-kdtree $(VENV)/runs/*-bvh --format csv -o $(VENV)/compare.csv
	$(BIN)/npcache compare $(VENV)/runs/*-bvh64 --line 64 --format csv -o $(VENV)/compare64.csv
	$(BIN)/python docs/columns.py docs/data/compare.csv $(PAY),demand_miss_rate,requests_per_read $(VENV)/compare.csv $(VENV)/compare64.csv
	$(BIN)/npcache time $(VENV)/runs/*-kdtree $(VENV)/runs/*-bvh $(RAYS) -o $(VENV)/rays.csv
	$(BIN)/npcache time $(VENV)/runs/*-bvh64 --line 64 $(RAYS) -o $(VENV)/rays64.csv
	$(BIN)/python docs/columns.py docs/data/rays.csv \
	  run,scene,tree,prefetch,rays,mshrs,cycles_per_ray,speed_up,traffic_ratio,accuracy,spent_port,cycles $(VENV)/rays.csv $(VENV)/rays64.csv

docs-check: $(INSTALLED) ## Fail if a figure in the pages is not what its command prints
	$(BIN)/cog --check $(PAGES)

site: $(INSTALLED) ## Build the documentation as a site, build/site/index.html; a broken link is an error
	@$(BIN)/python -c "import sphinx" 2>/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -q -c docs -d build/doctrees . build/site
	@echo "build/site/index.html"

correctness: $(INSTALLED) ## Run all checks, the hard cases (long form) and all mutations, about two hours, and write docs/correctness.md
	@test -f "$(NPTRACE_SCENES)/bunny.ply" || { echo "set NPTRACE_SCENES to the folder with the real scenes"; exit 2; }
	$(BIN)/python -m tests.checks -n $(THREADS) -o docs/data/checks.json
	$(BIN)/nptrace check --hard --long --json > docs/data/hard_cases.json
	$(BIN)/python -m tests.mutations -o docs/data/mutations.csv
	$(BIN)/cog -r docs/correctness.md

fuzz: $(INSTALLED) ## Try 100,000 inputs nobody would write and put their number into docs/correctness.md (N=1000000: more)
	$(BIN)/python -m tests.fuzz -n $(or $(N),100000) -o docs/data/fuzz.json
	$(BIN)/cog -r docs/correctness.md

bench: $(INSTALLED) ## Measure speed, about 15 minutes, and write docs/performance.md (ARGS=--quick: half a minute, writes nothing)
	$(BIN)/python -m tests.bench $(ARGS)
	$(BIN)/python -m tests.bench.scaling $(ARGS)
	$(BIN)/python -m tests.bench.large $(ARGS)
	$(BIN)/python -m tests.bench.scale $(ARGS)
	@test -n "$(ARGS)" || $(BIN)/cog -r docs/performance.md docs/scale.md

speed-error: $(INSTALLED) ## Measure speed against error and calibrate, an hour or two, and write docs/speed-error.md (ARGS=--quick: a minute, writes nothing)
	$(BIN)/python -m tests.bench.speed_error $(ARGS)
	$(BIN)/python -m tests.bench.arithmetic $(ARGS)
	$(BIN)/python -m tests.bench.clock_error $(ARGS)
	@test -n "$(ARGS)" || $(BIN)/python -m tests.bench.clock_error --held-out
ifneq ($(ARGS),--quick)
	$(BIN)/python -m tests.bench.estimate_speed
	rm -f docs/data/calibration.csv
	$(BIN)/python -m tests.bench.calibration
	$(BIN)/cog -r docs/speed-error.md
endif

clean: ## Remove the environments and the runs under traces/
	rm -rf .venv .venv-* $(wildcard traces/*/)
